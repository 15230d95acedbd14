"""What comes from outside, mutated, and inputs that were faults."""

from pathlib import Path

import numpy as np
import pytest
from fuzz_targets import FILES, Target, check, mutated, targets

from gffe_cl import GffeError

NAMES = tuple(f"{form}:{Path(file).name}" for form, files in FILES.items() for file in files)
DRAWN = ("unreal:numbering",)
CASES = sorted((Path(__file__).parent / "fuzz_cases").glob("*-*"))
MUTATIONS = 12


@pytest.mark.parametrize("name", [*NAMES, *DRAWN])
def test_mutations_end_well_or_in_one_line(name):
    target, rng = targets()[name], np.random.default_rng(len(name))
    check(target, target.seed) if target.drawn else target.read(target.seed)
    for _ in range(MUTATIONS):
        check(target, mutated(target, target.seed, rng))


@pytest.mark.parametrize("case", CASES, ids=lambda path: path.name)
def test_faults_that_were_found(case):
    check(targets()[case.name.rpartition("-")[0].replace("@", ":")], case.read_bytes())


def test_a_fault_is_found():
    """... or no fuzzing would find any."""

    class InLines(GffeError):
        def __str__(self):
            return "a\nb"

    def in_lines(data):
        raise InLines("")

    with pytest.raises(AssertionError, match="not one line"):
        check(Target(b"", in_lines), b"")
    with pytest.raises(ZeroDivisionError):
        check(Target(b"", lambda data: 1 // len(data)), b"")


def test_mutations_change_what_they_get():
    rng = np.random.default_rng(1)
    for name in ("sequence:sequence.json", "sequence:frame_1.exr"):
        target = targets()[name]
        assert len({mutated(target, target.seed, rng) for _ in range(50)}) > 40
