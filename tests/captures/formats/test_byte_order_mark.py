"""Text files of captures that begin with a byte order mark, as .NET and editors of Windows write them."""

from pathlib import Path

import pytest
from fuzz_targets import WRITERS

from gffe_cl import open_capture

TEXTS = (".json",)


@pytest.mark.parametrize("form", [form for form in WRITERS if form != "unreal"])
def test_texts_with_a_mark_open(tmp_path, form):
    folder = WRITERS[form](tmp_path)
    marked = [path for path in Path(tmp_path).rglob("*") if path.suffix in TEXTS]
    for path in marked:
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert marked and len(open_capture(folder).rendered) == 2
