"""What is known of devices from one process to the next: kept, recalled, forgotten, and never a reason to fail."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import foreign_files
import pytest
from device_infos import GPU, INTEL, POCL

from gffe_cl import GffeError
from gffe_cl.engine.opencl import probing
from gffe_cl.engine.opencl.device import list_devices, open_device
from gffe_cl.engine.opencl.probing import Probed


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("GFFE_DEVICE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(probing, "_failed", {})
    return tmp_path / "cache"


@pytest.fixture
def probes(monkeypatch):
    """Probing finds this list of devices; `calls` counts how often it was done."""

    class Probes:
        found, calls = [POCL, INTEL], 0

        def __call__(self):
            self.calls += 1
            return Probed([replace(info) for info in self.found])

    made = Probes()
    monkeypatch.setattr(probing, "probe", made)
    return made


def test_probing_happens_once(cache, probes):
    assert list_devices() == list_devices() == [POCL, INTEL] and probes.calls == 1
    probes.found = [POCL]
    assert list_devices() == [POCL, INTEL] and probes.calls == 1
    assert list_devices(refresh=True) == list_devices() == [POCL] and probes.calls == 2
    assert [path.suffix for path in cache.iterdir()] == [".json"]


def test_nothing_is_kept_where_that_is_off(monkeypatch, probes, tmp_path):
    monkeypatch.setenv("GFFE_DEVICE_CACHE", "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert list_devices() == list_devices() == [POCL, INTEL] and probes.calls == 2
    assert not list(tmp_path.rglob("devices-*"))


def test_the_cache_folder_is_the_users(monkeypatch, probes, tmp_path):
    monkeypatch.delenv("GFFE_DEVICE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert list_devices() == list_devices() and probes.calls == 1
    assert len(list(tmp_path.glob("gffe-cl/devices-*.json"))) == 1 or sys.platform != "linux"


def damaged():
    document = {"time": 1e9, "devices": [vars(POCL)]}
    yield from ("", "[]", "nonsense", "null", "[" * 100_000, '{"time": 1}', "\udcff\udcfe\0")
    yield json.dumps(document | {"time": "yesterday"})
    yield json.dumps(document | {"time": 1e12})
    yield json.dumps(document | {"devices": [vars(POCL) | {"megapixels_per_second": "fast"}]})
    yield json.dumps(document | {"devices": [vars(POCL) | {"index": None}]})
    yield json.dumps(document | {"devices": [vars(POCL) | {"color": "red"}]})
    yield json.dumps(document | {"devices": {"0:0": 1}})


@pytest.mark.parametrize("text", list(damaged()), ids=lambda text: text[:20] or "empty")
def test_a_damaged_file_is_replaced(cache, probes, text):
    list_devices()
    (path,) = cache.iterdir()
    whole = path.read_text()
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert list_devices() == [POCL, INTEL] and probes.calls == 2
    assert json.loads(path.read_text())["devices"] == json.loads(whole)["devices"]


@pytest.mark.parametrize("kind", foreign_files.KINDS)
def test_regular_files_only(cache, probes, kind):
    list_devices()
    (path,) = cache.iterdir()
    foreign_files.put(path, kind)
    assert foreign_files.within(10, list_devices) == [POCL, INTEL] and probes.calls == 2


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, monkeypatch, probes):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "folder", tmp_path / ("long" * 100)):
        monkeypatch.setenv("GFFE_DEVICE_CACHE", str(folder))
        assert list_devices() == [POCL, INTEL]
    assert probes.calls == 3


def test_other_drivers_are_probed_anew(cache, probes, tmp_path, monkeypatch):
    """A library that was replaced, another vendor, another variable of a driver, other code that probes."""
    library, icds = tmp_path / "libdriver.so", tmp_path / "vendors"
    icds.mkdir()
    library.write_text("a driver")
    (icds / "driver.icd").write_text(f"{library}\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(icds))

    def replace_library():
        library.write_text("a newer one")

    def install_another():
        (icds / "other.icd").write_text("libother.so.1\n")

    def find_its_library():
        monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
        (tmp_path / "libother.so.1").touch()

    def set_a_variable():
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")

    keys = [probing.fingerprint()]
    for change in (replace_library, install_another, find_its_library, set_a_variable):
        list_devices()
        assert probing.fingerprint() == keys[-1]
        change()
        keys.append(probing.fingerprint())
    assert len(set(keys)) == len(keys)
    list_devices()
    assert probes.calls == len(keys)


def test_what_another_version_found_is_not_recalled(cache, probes, tmp_path, monkeypatch):
    """It may have ranked devices by another figure."""
    older = tmp_path / "probing.py"
    older.write_text(Path(probing.__file__).read_text("utf-8") + "# another one\n", "utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(probing, "__file__", str(older))
        list_devices()
    probes.found = [POCL]
    assert list_devices() == [POCL] and probes.calls == 2


def age(cache, seconds):
    (path,) = cache.glob("devices-*.json")
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"time": document["time"] - seconds}))


@pytest.mark.parametrize("found", [[], [replace(INTEL, works=False, problem="driver crashed (exit code -6)")]])
def test_the_next_process_tries_again_where_nothing_works(cache, probes, monkeypatch, found):
    """A driver may crash once, under load."""
    probes.found = found
    for calls in (1, 2, 3):
        assert list_devices() == list_devices() == found and probes.calls == calls
        monkeypatch.setattr(probing, "_failed", {})  # as in the next process
    with pytest.raises(GffeError, match="gffe devices --refresh"):
        open_device()


def test_a_failure_that_two_processes_met_is_tried_again_after_an_hour(cache, probes, monkeypatch):
    probes.found = [POCL, replace(INTEL, works=False, problem="busy")]
    for seconds, calls in ((0, 1), (0, 2), (1800, 2), (3600, 3)):
        if seconds:
            age(cache, seconds)
        assert list_devices() == list_devices() == probes.found and probes.calls == calls
        monkeypatch.setattr(probing, "_failed", {})
    probes.found = [POCL, INTEL]
    age(cache, 3700)
    assert list_devices() == list_devices() == [POCL, INTEL] and probes.calls == 4


def test_what_works_stays_known(cache, probes, monkeypatch):
    monkeypatch.setattr(probing, "vendors", lambda: ["a.icd"])
    monkeypatch.setattr(probing, "fingerprint", lambda: "key")
    list_devices()
    age(cache, 1e7)
    list_devices()
    assert probes.calls == 1
    monkeypatch.setattr(probing, "vendors", list)  # drivers that no file tells of
    list_devices()
    assert probes.calls == 2


def test_only_the_newest_files_stay(cache, probes):
    cache.mkdir()
    for k in range(30):
        probing.keep(f"key{k}", Probed([POCL]))
        os.utime(cache / f"devices-key{k}.json", (k, k))
    probing.keep("newest", Probed([POCL]))
    assert len(list(cache.iterdir())) == 16 and probing.recall("newest").devices == [POCL]


@pytest.fixture(scope="module")
def probed():
    """What probing really finds, once."""
    return probing.probe()


def test_a_known_device_that_is_not_there_is_looked_for(cache, device, monkeypatch, probed):
    """The first process knew another device of that index, or more devices than there are; a kernel never saw it."""
    there = device.info.index
    monkeypatch.delenv("GFFE_DEVICE", raising=False)
    for gone in (replace(GPU, index=there), replace(GPU, index="9:9"), replace(GPU, index="0:99")):
        calls = []
        monkeypatch.setattr(probing, "probe", lambda calls=calls: calls.append(1) or probed)
        probing.keep(probing.fingerprint(), Probed([replace(gone)]))
        opened = open_device(there)
        assert opened.info.name == device.info.name and len(calls) == 1
        assert open_device(there).info == opened.info and len(calls) == 1


def test_no_known_device_matches(cache, probes):
    list_devices()
    with pytest.raises(GffeError, match="no working device matches 'abacus'"):
        open_device("abacus")
    assert probes.calls == 2  # it may have come since


def test_children_recall_what_their_parent_found(cache, device):
    """Neither a child of a process nor what it starts probes again."""
    list_devices()
    code = (
        "from gffe_cl.engine.opencl import device, probing\n"
        "def probe(): raise SystemExit('probed again')\n"
        "probing.probe = probe\n"
        "print(len(device.list_devices()), device.open_device().info.name)\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0, child.stderr


def test_the_command_refreshes(cache, probes, tmp_path, capsys):
    from gffe_cl.cli.commands import invoke

    for arguments, calls in (([], 1), ([], 1), (["--refresh"], 2)):
        assert invoke(["devices", *arguments, "--json", str(tmp_path / "report.json")]) == 0
        assert probes.calls == calls
        listed = json.loads((tmp_path / "report.json").read_text())["devices"]
        assert [(info["name"], info["default"]) for info in listed] == [(POCL.name, False), (INTEL.name, True)]
    said = capsys.readouterr().out
    assert "--refresh" in said and re.search(r"^ *\* +1:0 .* yes +4 +nothing", said, re.MULTILINE), said


def test_the_version_names_runtimes(cache, probes, capsys):
    from gffe_cl.cli.commands import invoke

    probes.found = [POCL, replace(INTEL, works=False)]
    assert invoke(["--version"]) == 0
    version, runtimes = capsys.readouterr().out.splitlines()
    assert version.startswith("gffe-cl ") and runtimes == f"OpenCL: {POCL.platform} ({POCL.driver})"


def test_the_command_says_how_old_a_rank_is(cache, probes, tmp_path, capsys):
    """It may have been measured while other programs were busy."""
    from gffe_cl.cli.commands import invoke

    def told(*arguments):
        assert invoke(["devices", *arguments, "--json", str(tmp_path / "report.json")]) == 0
        report = json.loads((tmp_path / "report.json").read_text())
        return capsys.readouterr().out, report["age_seconds"], [info["default"] for info in report["devices"]]

    probes.found = [replace(POCL, megapixels_per_second=2.0), replace(INTEL, megapixels_per_second=1.0)]
    said, seconds, default = told()
    assert "tested just now; " in said and seconds == 0 and default == [True, False]
    probes.found = [POCL, INTEL]
    age(cache, 3 * 86400)
    said, seconds, default = told()
    assert "tested 3 days ago; other programs slow the test down: --refresh repeats it" in said
    assert 3 * 86400 <= seconds < 3 * 86400 + 60 and default == [True, False]
    said, seconds, default = told("--refresh")
    assert "tested just now; " in said and seconds == 0 and default == [False, True]
