"""What comes from outside, mutated, and inputs that were faults."""

from pathlib import Path

import numpy as np
import pytest
from fuzz_targets import FILES, WRITERS, check, mutated, targets

from gffe_cl import open_capture

NAMES = tuple(f"{form}:{Path(file).name}" for form, files in FILES.items() for file in files)
CASES = sorted((Path(__file__).parent / "fuzz_cases").glob("*-*"))
MUTATIONS = 12


@pytest.mark.parametrize("name", NAMES)
def test_mutations_end_well_or_in_one_line(name):
    target, rng = targets()[name], np.random.default_rng(len(name))
    target.read(target.seed)
    for _ in range(MUTATIONS):
        check(target, mutated(target, target.seed, rng))


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.name)
def test_faults_that_were_found(case):
    check(targets()[case.name.rpartition("-")[0].replace("@", ":")], case.read_bytes())


@pytest.mark.parametrize("form", [form for form in WRITERS if form != "unreal"])
def test_texts_with_a_byte_order_mark_open(tmp_path, form):
    """As .NET and editors of Windows write them."""
    folder = WRITERS[form](tmp_path)
    for path in tmp_path.rglob("*.json"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(open_capture(folder).rendered) == 2
