"""Settings that are kept under a name, and the command line that gives them."""

import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from gffe_cl import Options
from gffe_cl.viewer.engine.messages import Setup
from gffe_cl.viewer.state.presets import Kept, KeptSettings, command_line

SOURCE = SimpleNamespace(target="shots/a b", name="a b", live=False, width=8, height=4)
OTHER = Options(
    motion=False, history=4, order=3, static_threshold=1.23456789, levels=2, hole_filling="downsample", blocks=False,
    soft_silhouettes=False, shading_correction=True, focus_mask=False, scn_model="my net.onnx", scn_provider="cuda",
)  # fmt: skip


class Stop(Exception):
    pass


def parsed(line: str, monkeypatch) -> dict:
    """What `gffe run` makes of a command line: the arguments of the function that runs."""
    import typer

    from gffe_cl.cli import commands  # noqa: F401
    from gffe_cl.cli import run as run_module
    from gffe_cl.cli.common import app

    found = {}

    def stand_in(target, window, device, live, scale=0.0):
        found.update(target=target, window=window, live=live)
        return None, SimpleNamespace(count=1)

    def run_sequence(source, output, device, options, alphas, **rest):
        found.update(output=output, options=options, alphas=alphas)
        raise Stop

    monkeypatch.setattr(run_module, "open_source", stand_in)
    monkeypatch.setattr(run_module, "_check_quickly", lambda *_: (False, None))
    monkeypatch.setattr("gffe_cl.captures.offline.run.run_sequence", run_sequence)
    words = shlex.split(line)
    assert words[0] == "gffe"
    with pytest.raises(Stop):
        typer.main.get_command(app)(words[1:], standalone_mode=False)
    return found


@pytest.mark.parametrize(
    "options", [Options(), OTHER, Options(levels=0, hole_filling="none", overlays=False, shading_correction=False)]
)
def test_the_command_line_gives_the_same_options(options, monkeypatch):
    found = parsed(command_line(Setup(options, "off", 3), SOURCE, 0), monkeypatch)
    assert found["options"] == replace(options, shading_inputs=False)
    assert found["target"] == Path("shots/a b").absolute() and found["window"] == "off"
    assert found["alphas"] == [0.25, 0.5, 0.75] and str(found["output"]) == "a b_extrapolated"


def test_the_command_line_of_a_scene(monkeypatch):
    scene = SimpleNamespace(target="corridor", name="corridor", live=True, width=320, height=180)
    found = parsed(command_line(Setup(Options(), "adaptive"), scene, 7), monkeypatch)
    assert str(found["target"]) == "corridor" and found["window"] == "adaptive"
    assert found["live"]["--size"] == "320x180" and found["live"]["--seed"] == 7
    assert "--window" not in command_line(Setup(Options(), "off"), scene, 0)


def test_kept_settings_are_saved_and_found_again():
    settings, texts = KeptSettings(), "12ab"
    first = settings.keep(Setup(Options()), texts)
    second = settings.keep(Setup(Options(motion=False, levels=0), "off"), texts)
    assert (first.name, second.name) == ("defaults", "no motion estimation, no background levels")
    assert settings.b == second and second.setup(3) == Setup(Options(motion=False, levels=0), "off", 3, texts)
    again = settings.keep(Setup(Options()), texts)
    assert [kept.name for kept in settings.all] == [again.name, second.name], "the same settings are kept once"
    settings.rename(second, "  flat  ")
    settings.rename(settings.all[0], "flat")
    assert [kept.name for kept in settings.all] == [again.name, "flat"], "names are not taken twice"
    found = KeptSettings()
    found.restore([*settings.preferences(), {"name": 3}, {"name": "x", "options": {"levels": 99}}, None])
    assert [(kept.name, kept.options, kept.window) for kept in found.all] == [
        (kept.name, kept.options, kept.window) for kept in settings.all
    ]
    assert found.b is None and all(kept.kernels == "" for kept in found.all)
    found.choose("flat")
    assert found.b.window == "off"
    found.forget(found.b)
    assert found.b == found.all[0]
    foreign = [settings.keep(Setup(Options()), build, Path("/x/edited")) for build in ("34cd", "56ef")]
    stored = [settings.keep_stored(place, Options()) for place in ("/x/out", "/y/out", "/x/out")]
    names = [kept.name for kept in (*foreign, *stored[1:])]
    assert names == ["defaults, kernels of x/edited", "defaults, kernels of x/edited (2)", "y/out", "x/out"]
    assert len(settings.preferences()) == 2 and len(settings.all) == 6, "neither is there after a restart"


def test_a_network_that_changed_is_told(tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(b"1")
    kept = KeptSettings().keep(Setup(Options(scn_model=str(path))), "")
    assert not kept.suspicion
    path.write_bytes(b"22")
    assert "changed" in kept.suspicion
    assert not Kept.from_json(kept.to_json()).suspicion
