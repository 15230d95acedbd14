"""What runs the network: providers are compared with the CPU in a child process, refused where they differ, and their
failures survived. WebGPU itself runs on SwiftShader, a Vulkan for CPUs, where it is to be had."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import foreign_files
import numpy as np
import pytest
import tiny_sequence
from onnx import helper
from scn_models import constant_model, look_model, pooling_model, save

from gffe_cl import GffeError
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference import provider_check, provider_choice
from gffe_cl.engine.inference import providers as runtime
from gffe_cl.engine.inference.model_interface import shapes_at
from gffe_cl.engine.inference.network import Network, NetworkError, load_network
from gffe_cl.engine.inference.provider_check import ProviderVerdict, verdict
from gffe_cl.engine.inference.provider_choice import Choice, choose
from gffe_cl.engine.inference.providers import CPU, PROVIDERS

WEBGPU = PROVIDERS["webgpu"]
FOLDERS = (os.environ.get("GFFE_SWIFTSHADER", ""), "/usr/lib/chromium")


def conv_model(path, channels=6):
    """A convolution of so many of the input's channels, as the shipped network has; 1 × 1 after it."""
    rng = np.random.default_rng(1)
    constants = {
        "first": rng.normal(0, 0.1, (16, channels, 3, 3)).astype(np.float32),
        "second": rng.normal(0, 0.1, (20, 16, 1, 1)).astype(np.float32),
        "which": np.arange(channels),
    }
    nodes = [
        helper.make_node("Gather", ["candidates", "which"], ["some"], axis=1),
        helper.make_node("Conv", ["some", "first"], ["middle"], pads=[1, 1, 1, 1]),
        helper.make_node("Conv", ["middle", "second"], ["judgement"]),
    ]
    return Path(save(path, nodes, constants))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("GFFE_DEVICE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


# ---- choosing ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cuda", "tensorrt", "directml", "openvino", "CoreMLExecutionProvider", "abacus"])
def test_providers_that_are_not_there(tmp_path, name):
    known = PROVIDERS.get(name) or next((each for each in PROVIDERS.values() if each.ort == name), None)
    if known and known.installed:
        pytest.skip("is there")
    with pytest.raises(
        GffeError, match=rf"provider '{known.name if known else name}' is not available .*there is: .*cpu"
    ) as caught:
        load_network(look_model(tmp_path / "m.onnx"), name)
    assert "\n" not in str(caught.value)
    assert not known or known.package in str(caught.value)


def passing(provider, milliseconds):
    return ProviderVerdict(provider, "GPU", 1e-6, milliseconds, 90.0)


@pytest.mark.parametrize(
    "found, expected, remark",
    [
        ({}, "cpu", ""),
        ({"webgpu": passing("webgpu", 5.0), "openvino": passing("openvino", 50.0)}, "webgpu", ""),
        ({"webgpu": passing("webgpu", 200.0)}, "cpu", ""),
        ({"webgpu": passing("webgpu", float("inf"))}, "cpu", ""),
        ({"webgpu": ProviderVerdict("webgpu", problem="no device", present=False)}, "cpu", ""),
        ({"webgpu": ProviderVerdict("webgpu", problem="its results differ")}, "cpu", "its results differ"),
        (
            {"webgpu": ProviderVerdict("webgpu", problem="crashed"), "openvino": passing("openvino", 9.0)},
            "openvino",
            "crashed",
        ),
    ],
)
def test_auto_is_the_fastest_that_passes(monkeypatch, found, expected, remark):
    monkeypatch.setattr(provider_choice, "installed_providers", lambda: [CPU, *(PROVIDERS[name] for name in found)])
    monkeypatch.setattr(provider_choice, "verdict", lambda path, provider: found[provider.name])
    assert choose(Path("m"), "auto") == Choice(PROVIDERS[expected], expected != "cpu", remark)
    for name, each in found.items():
        monkeypatch.setattr(provider_choice, "find_provider", PROVIDERS.__getitem__)
        if each.passes:
            assert choose(Path("m"), name) == Choice(PROVIDERS[name])
        else:
            with pytest.raises(NetworkError, match=each.problem):
                choose(Path("m"), name)


def test_verdicts_are_kept(cache, tmp_path, monkeypatch):
    """As long as nothing changes; what did not work for an hour."""
    path, calls = Path(look_model(tmp_path / "m.onnx")), []
    answer = passing("webgpu", 5.0)

    def ask(*given):
        calls.append(given)
        return replace(answer)

    monkeypatch.setattr(provider_check, "_in_child", ask)
    assert verdict(path, WEBGPU) == verdict(path, WEBGPU) == answer and len(calls) == 1
    verdict(path, PROVIDERS["cuda"])
    verdict(path, WEBGPU, refresh=True)
    constant_model(path)
    verdict(path, WEBGPU)
    monkeypatch.setenv("VK_DRIVER_FILES", "/another.json")
    verdict(path, WEBGPU)
    assert len(calls) == 5
    answer = ProviderVerdict("webgpu", problem="its driver crashed")
    verdict(path, WEBGPU, refresh=True)
    assert verdict(path, WEBGPU) == answer and len(calls) == 6
    newest = max(cache.iterdir(), key=lambda file: file.stat().st_mtime)
    os.utime(newest, (1e9, 1e9))
    verdict(path, WEBGPU)
    assert len(calls) == 7
    for text in ("", "[]", '{"provider": 1}', json.dumps({"provider": "webgpu", "difference": "no"}), "[" * 100_000):
        newest.write_text(text)
        verdict(path, WEBGPU)
    assert len(calls) == 12
    for kind in foreign_files.KINDS:
        foreign_files.put(newest, kind)
        assert foreign_files.within(10, lambda: verdict(path, WEBGPU)) == answer
        if kind == "folder":
            newest.rmdir()
    assert len(calls) == 12 + len(foreign_files.KINDS)


def test_the_cpu_is_timed_with_the_file_that_it_runs(tmp_path, monkeypatch):
    """And gives the results to compare with by that of the provider."""
    path, on_cpu = Path(look_model(tmp_path / "m.onnx")), Path(constant_model(tmp_path / "n.onnx"))
    opened = []
    monkeypatch.setattr(provider_check, "cpu_model", {path: on_cpu}.__getitem__)
    monkeypatch.setattr(provider_check, "open_session", lambda file: opened.append(file) or runtime.open_session(file))
    found = provider_check.compare(path, CPU)
    assert found.passes and found.difference == 0 and found.cpu_milliseconds < 1e4, found
    assert opened == [path, on_cpu]


PLUGIN = "import os, signal, time\ndef get_library_path():\n    {}\n"


@pytest.mark.parametrize(
    "does, problem",
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "crashed .exit code -11"),
        ("time.sleep(60)", "hangs .1 s"),
        ("return '/none.so'", "plug-in cannot be loaded: .*none.so"),
        ("raise OSError('two\\nlines')", "plug-in cannot be loaded: two lines"),
    ],
)
def test_what_a_driver_does_is_no_harm(cache, tmp_path, monkeypatch, does, problem):
    """A plug-in that crashes, hangs or fails where its library is loaded: in a child, as told by one line."""
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / f"{WEBGPU.plugin}.py").write_text(PLUGIN.format(does))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "plugins"))
    monkeypatch.setattr(provider_check, "_SECONDS", 1 if "hangs" in problem else 60)
    monkeypatch.syspath_prepend(tmp_path / "plugins")
    with pytest.raises(NetworkError, match=f"provider webgpu: .*{problem}") as caught:
        load_network(look_model(tmp_path / "m.onnx"), "webgpu")
    assert "\n" not in str(caught.value)


def test_devices_says_what_may_run_the_network(gffe, tmp_path, monkeypatch):
    found = {
        "webgpu": ProviderVerdict("webgpu", "Fast GPU", 2e-6, 5.0, 90.0),
        "cuda": ProviderVerdict("cuda", problem="provider cuda: its driver crashed (exit code -11)"),
        "openvino": ProviderVerdict("openvino", "Slow one", 2e-6),
    }
    monkeypatch.setattr(inference, "default_model", lambda: Path(look_model(tmp_path / "m.onnx")))
    monkeypatch.setattr(runtime, "installed_providers", lambda: [CPU, *(PROVIDERS[name] for name in found)])
    monkeypatch.setattr(provider_check, "verdict", lambda path, provider, refresh: found[provider.name])
    code, text, _ = gffe("devices", "--json", tmp_path / "d.json")
    text = " ".join(text.split())
    assert code == 0 and "provider webgpu: Fast GPU, 5.0 ms for 960×540, the CPU 90.0 ms; differs" in text
    assert "provider cuda: its driver crashed (exit code -11)" in text and "openvino: Slow one, very slow;" in text
    providers = json.loads((tmp_path / "d.json").read_text())["providers"]
    assert [each["milliseconds"] for each in providers] == [5.0, None, None]


# ---- failures meanwhile --------------------------------------------------------------------------------


class Failing:
    """A session on a provider whose driver gives up in the second run."""

    copying, runs = 0.0, 0

    def __init__(self, *_):
        pass

    def run(self, inputs, name, output):
        self.runs += 1
        if self.runs == 2:
            raise RuntimeError("device\nlost")
        output[:] = 7


@pytest.mark.parametrize("named", [False, True])
def test_a_driver_that_fails_while_it_runs(tmp_path, monkeypatch, named):
    """Where the provider was chosen automatically, the CPU takes over for good; else it is an error."""
    monkeypatch.setattr(inference, "FixedSession", Failing)
    monkeypatch.setattr(inference, "choose", lambda *_: Choice(WEBGPU, may_fall_back=not named))
    network = Network(Path(look_model(tmp_path / "m.onnx")), "auto")
    *inputs, judgement = (np.full(shape[1:], 3, np.float32) for shape in shapes_at(16, 32).values())
    network.prepare(16, 32)
    network.run(*inputs, judgement)
    assert (judgement == 7).all() and network.provider == WEBGPU.ort and not network.remark
    if named:
        with pytest.raises(NetworkError, match=r"m.onnx: the network failed on WebGpu\w+: device lost"):
            network.run(*inputs, judgement)
        return
    for _ in range(3):
        network.run(*inputs, judgement)
        assert (judgement == 3).all() and network.provider == CPU.ort and network.copying == 0
    assert network.remark.count("device lost") == 1 and "went on on the CPU" in network.remark


def test_a_network_that_fails_on_the_cpu_too(tmp_path, monkeypatch):
    """... is an error, whatever was chosen how."""
    monkeypatch.setattr(inference, "FixedSession", Failing)
    monkeypatch.setattr(inference, "choose", lambda *_: Choice(WEBGPU, may_fall_back=True))
    network = Network(Path(pooling_model(tmp_path / "m.onnx")), "auto")
    *inputs, judgement = (np.full(shape[1:], 3, np.float32) for shape in shapes_at(16, 32).values())
    network.run(*inputs, judgement)
    for _ in range(2):
        with pytest.raises(NetworkError, match=r"m.onnx: the network failed on CPUExecutionProvider"):
            network.run(*inputs, judgement)


def test_a_driver_that_fails_as_a_session_is_made(device, tmp_path, monkeypatch):
    def fails(*_):
        raise RuntimeError("no memory")

    monkeypatch.setattr(inference, "FixedSession", fails)
    monkeypatch.setattr(inference, "choose", lambda *_: Choice(WEBGPU, may_fall_back=True))
    from gffe_cl import Options, Pipeline

    options = Options(scn_model=look_model(tmp_path / "m.onnx"), scn_provider="auto")
    network = Pipeline(device, 32, 32, options).stages["correction"].network
    assert network.provider == CPU.ort and "no memory" in network.remark


def test_kernels_run_the_network_where_onnxruntime_is_not_installed(monkeypatch):
    monkeypatch.setattr(inference, "_loaded", {})
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    network = load_network(runtime.cpu_model(runtime.PACKAGED), None)
    assert network.layers and inference.reason(network, None, on_gpu=False) == "onnxruntime is not installed"
    runtime.load_onnxruntime.cache_clear()
    with pytest.raises(NetworkError, match="onnxruntime is not installed"):
        load_network(runtime.PACKAGED, CPU.name)


@pytest.mark.parametrize("command", ["run", "eval", "view"])
def test_every_command_says_once_that_the_cpu_went_on(device, gffe, tmp_path, monkeypatch, command):
    """... the viewer in its window, too."""
    monkeypatch.setattr(inference, "choose", lambda *_: Choice(CPU, remark="provider webgpu: crashed"))
    scn = ("--scn-provider", "auto", "--scn-model", look_model(tmp_path / "m.onnx"))
    said = []
    if command == "run":
        tiny_sequence.write(tmp_path / "in", frames=2)
        arguments = ("run", tmp_path / "in", tmp_path / "out", "--no-check")
    elif command == "eval":
        options = ("--methods", "gffe", "--frames", "4", "--size", "64x36", "--out", tmp_path / "report")
        arguments = ("eval", "corridor", *options)
    else:
        pytest.importorskip("imgui_bundle")
        monkeypatch.setattr("gffe_cl.viewer.window.start.require_display", lambda: None)
        monkeypatch.setattr("gffe_cl.viewer.window.start.view", lambda model, *_: said.extend(model.messages))
        arguments = ("view", "--cache", "0")
    code, _, err = gffe(*arguments, "--device", device.info.index, *scn)
    assert code == 0 and err.count("warning: provider webgpu: crashed") == 1, err
    assert [each.text for each in said] == ["provider webgpu: crashed"] * (command == "view")


# ---- WebGPU on SwiftShader -----------------------------------------------------------------------------


@pytest.fixture
def swiftshader(tmp_path, monkeypatch):
    """Variables with which WebGPU's plug-in finds SwiftShader, in this process's children. Their values, and so what is
    kept of providers, are new in every test."""
    if not find_spec(WEBGPU.plugin):
        pytest.skip(f"{WEBGPU.package} is not installed")
    folder = next((Path(each) for each in FOLDERS if each and (Path(each) / "libvk_swiftshader.so").is_file()), None)
    if folder is None:
        pytest.skip("no SwiftShader (expected in GFFE_SWIFTSHADER, or of Debian's chromium-common)")
    libraries = tmp_path / "libraries"  # nothing else of that folder
    libraries.mkdir()
    if (folder / "libvulkan.so.1").is_file():
        (libraries / "libvulkan.so.1").symlink_to(folder / "libvulkan.so.1")
    driver = tmp_path / "swiftshader.json"
    about = {"library_path": str(folder / "libvk_swiftshader.so"), "api_version": "1.0.5"}
    driver.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": about}))
    monkeypatch.setenv("ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER", "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{libraries}:{os.environ.get('LD_LIBRARY_PATH', '')}".rstrip(":"))
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, str(driver))


def command(*arguments):
    """`gffe ARGUMENTS` in a process of its own, which loads Vulkan: (exit code, stdout, stderr)."""
    start = [sys.executable, "-m", "gffe_cl", *map(str, arguments)]
    done = subprocess.run(start, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.long
def test_webgpu_is_refused_where_it_is_wrong(swiftshader, gffe, tmp_path):
    """Its convolution of 6 channels is (plug-in 0.4.0); the line says all that a report needs. Padded, it passes."""
    pytest.importorskip("onnx")
    from gffe_cl.lab.training.channels import pad_file

    path = conv_model(tmp_path / "narrow.onnx")
    tiny_sequence.write(tmp_path / "in", frames=2)
    run = ("run", tmp_path / "in", tmp_path / "out", "--no-check", "--scn-model", path)
    code, _, err = gffe(*run, "--scn-provider", "webgpu")
    if code == 0:
        pytest.skip("this plug-in computes it rightly")
    assert code == 2 and "Traceback" not in err and not (tmp_path / "out").exists()
    said = " ".join(err.split())
    assert said.startswith("error: provider webgpu on") and "differ from the CPU's by" in said
    assert "please report this line: narrow.onnx, onnxruntime " in said and "onnxruntime-ep-webgpu " in said
    code, _, err = gffe(*run, "--scn-provider", "auto")  # goes on with the CPU, and says why
    assert code == 0 and err.count("differ from the CPU's by") == 1, err
    assert pad_file(path, path) == 1
    found = verdict(path, WEBGPU)
    assert found.passes and found.difference < 1e-5, found


@pytest.mark.long
def test_webgpu_gives_the_cpus_frames(swiftshader, gffe, tmp_path):
    """Through the whole command; what the copies take is among the timings."""
    path = conv_model(tmp_path / "m.onnx", 8)
    tiny_sequence.write(tmp_path / "in", frames=4)
    from gffe_cl import open_sequence

    reports, pictures = {}, {}
    for name in ("cpu", "webgpu"):
        out, report = tmp_path / name, tmp_path / f"{name}.json"
        run = ("run", tmp_path / "in", out, "--no-check", "--no-focus-mask", "--scn-model", path, "--json", report)
        start = gffe if name == "cpu" else command
        code, _, err = start(*run, "--scn-provider", name)
        assert code == 0 and "provider" not in err and "network" not in err, err
        reports[name] = json.loads(report.read_text())["milliseconds"]
        sequence = open_sequence(out)
        pictures[name] = [sequence.read_color(entry) for entry in sequence.extrapolated]
    assert len(pictures["cpu"]) == 4
    for a, b in zip(pictures["cpu"], pictures["webgpu"], strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-3)
    assert reports["webgpu"]["network copies"] > 0 and reports["webgpu"]["network"] > 0


ASSIGNED = """
import sys, collections
from pathlib import Path
from gffe_cl.engine.inference import providers as runtime
from gffe_cl.engine.inference.model_interface import shapes_at
from gffe_cl.engine.inference.sessions import FixedSession
onnxruntime = runtime.load_onnxruntime()
made = onnxruntime.SessionOptions
def recording():
    options = made()
    options.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
    return options
onnxruntime.SessionOptions = recording
path = Path(sys.argv[1])
session = FixedSession(path, runtime.PROVIDERS["webgpu"], shapes_at(48, 80), runtime.open_session(path)).session
print(*sorted({part.ep_name for part in session.get_provider_graph_assignment_info()}))
"""


def test_no_node_of_the_shipped_network_falls_back(swiftshader, default_model):
    done = subprocess.run([sys.executable, "-c", ASSIGNED, str(default_model())], capture_output=True, text=True)
    assert done.stdout.split() == [WEBGPU.ort], done.stderr


@pytest.mark.long
def test_webgpu_runs_the_shipped_network(swiftshader, default_model):
    found = verdict(default_model(), WEBGPU)
    assert found.passes and found.difference < 1e-4, found
