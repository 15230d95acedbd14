"""The viewer attached to a running program: what it shows and switches there, and what is left when either dies."""

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gffe_cl as gffe
from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import load_scene
from gffe_cl.engine.inspection.attached import channel, client, wire
from gffe_cl.engine.inspection.attached.encoding import encoded
from gffe_cl.viewer.engine.sources.attached import resolved
from gffe_cl.viewer.engine.sources.program import RunningProgram
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.saving import RecordingWork
from gffe_cl.viewer.state.settings import Settings

W, H = 160, 96
PATIENCE = 150.0
NAME = f"game{os.getpid()}"
PROGRAM = Path(__file__).with_name("attached_program.py")


def attached():
    """Return the names of the attached programs of this process's tests."""
    return [name for name in channel.programs() if name.startswith(NAME)]


def until(happens, what="something"):
    end = time.monotonic() + PATIENCE
    while not (found := happens()):
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.005)
    return found


# ---- sockets ---------------------------------------------------------------------------------------------------------


def test_names(monkeypatch):
    first, second = channel.Listener(None, NAME), channel.Listener(None, NAME)
    assert [first.name, second.name] == [NAME, f"{NAME}-2"] == attached()
    with pytest.raises(gffe.GffeError, match=f"attached as '{NAME}' already"):
        channel.Listener(NAME, "stem")
    with pytest.raises(gffe.GffeError, match=rf"no program is attached as 'gam' \(there are: .*{NAME}, {NAME}-2"):
        channel.connect("gam")
    monkeypatch.setattr(channel, "programs", list)
    with pytest.raises(gffe.GffeError, match=r"\(there is none: call gffe_cl.attach\(pipeline\) in the program\)"):
        channel.connect("gam")
    for name in ("", "../x", "a b", "x" * 65):
        with pytest.raises(gffe.GffeError, match="attach: name must be"):
            channel.Listener(name, "stem")
    first.close()
    second.close()
    assert attached() == []


def test_nothing_is_left_of_a_dead_program():
    lives = f"from gffe_cl.engine.inspection.attached.channel import Listener; print(Listener({NAME!r}, 'a').name)"
    done = subprocess.run([sys.executable, "-c", lives], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [NAME] and attached() == []


def test_other_users_are_refused(monkeypatch):
    """Neither side talks to a process of another user; the peer's identity is the kernel's."""
    listener, own = channel.Listener(NAME, NAME), os.getuid()
    taken = []

    def accept():
        with suppress(OSError):  # in the end it is closed
            taken.append(listener.accept())

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    uid = lambda _: own + (threading.current_thread() is thread)  # noqa: E731  another one for the program
    monkeypatch.setattr(channel, "_peer_uid", uid)
    foreign = channel.connect(NAME)
    with pytest.raises(EOFError):
        foreign.receive(PATIENCE)
    assert not taken
    monkeypatch.setattr(channel, "_peer_uid", lambda connected: own + 1)
    with pytest.raises(gffe.GffeError, match="is another user's"):
        channel.connect(NAME)
    listener.close()


def test_kernel_tells_the_user():
    with socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)[0] as one:
        assert channel._peer_uid(one) == os.getuid()


def test_other_systems_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(gffe.GffeError, match="attach: this system is win32 \\(expected Linux") as refused:
        channel.Listener(NAME, NAME)
    assert "\n" not in str(refused.value)


# ---- what others do to the sockets -----------------------------------------------------------------------------------


def test_nobody_waits_for_a_program_that_does_not_accept(monkeypatch):
    """As one in a debugger, or with a viewer, whose queue is full."""
    stopped = channel.Listener(NAME, NAME)
    waiting = []
    with suppress(BlockingIOError):
        while True:
            waiting.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK))
            waiting[-1].connect(channel.address_of(NAME))
    start = time.monotonic()
    others = [channel.Listener(None, NAME) for _ in range(20)]
    assert time.monotonic() - start < 5
    assert [other.name for other in others[:2]] == [f"{NAME}-2", f"{NAME}-3"]
    with pytest.raises(gffe.GffeError, match=f"attached as '{NAME}' already"):
        channel.Listener(NAME, NAME)
    monkeypatch.setattr(channel, "_CONNECT_SECONDS", 0.2)
    with pytest.raises(gffe.GffeError, match=f"{NAME}: no answer"):
        channel.connect(NAME)
    for one in (*waiting, *others, stopped):
        one.close()
    assert attached() == []


def test_versions_are_compared_first():
    """In plain text, so that any version can tell."""
    listener = channel.Listener(NAME, NAME)

    def answer(hello):
        connected, _ = listener._socket.accept()
        assert connected.recv(100) == f"gffe-cl attach {channel.own_version()}\n".encode()
        connected.send(hello)
        connected.close()

    for hello, expected in (
        (b"gffe-cl attach 0.0.1\n", f"{NAME}: it runs gffe-cl 0.0.1, this viewer is of"),
        (pickle.dumps("hello"), f"{NAME}: it runs gffe-cl another version, this viewer is of"),
    ):
        thread = threading.Thread(target=answer, args=(hello,), daemon=True)
        thread.start()
        with pytest.raises(gffe.GffeError, match=expected):
            RunningProgram(NAME, 3)
        thread.join()
    listener.close()


# ---- a program in this process -----------------------------------------------------------------------------------


class Game:
    """Renders frames when asked to."""

    def __init__(self, device):
        self.pipeline = gffe.Pipeline(device, W, H, gffe.Options(shading_correction=False))
        self._frames = Live(load_scene("plaza"), device, W, H, 1000, 30.0).frames([0.5], False)
        self.attachment = gffe.attach(self.pipeline, NAME, pacer=gffe.Pacer(60))

    def step(self):
        self.frame = next(self._frames)[1]
        self.pipeline.submit(self.frame)
        self.made = self.pipeline.extrapolate(time=self.frame.time + 1 / 60)
        self.color = self.made.numpy("color")

    def while_running(self, look):
        """What `look` returns, while frames are rendered."""
        found = []
        thread = threading.Thread(target=lambda: found.append(look()), daemon=True)
        thread.start()
        end = time.monotonic() + PATIENCE
        while thread.is_alive() and time.monotonic() < end:
            self.step()
            thread.join(0.01)
        assert found, "nothing was seen"
        return found[0]


@pytest.fixture
def game(device):
    game = Game(device)
    yield game
    game.attachment.close()


def see(program, *layers, generated=True):
    return program.see(frozenset(layers), generated, lambda: None)


@pytest.mark.device
def test_layers_are_the_pipelines(game):
    """Those of the next whole frame, although they are asked for in the midst of one, which has not kept them."""
    colors, in_the_midst = {}, threading.Event()

    def remember():
        game.made and colors.setdefault(game.frame.time, game.color)

    program = RunningProgram(NAME, 8)
    assert game.pipeline.options == program.options and program.about.display == (W, H)
    until(lambda: game.attachment.watched, "the program to notice")
    game.step()  # nothing moves after the first frame: the warp's color would be the final one
    step, watcher = game.step, game.pipeline.watcher
    extrapolated = watcher.extrapolated

    def made(*frame):
        if not in_the_midst.is_set():
            in_the_midst.set()
            until(lambda: watcher.viewer.looks, "the request")
        extrapolated(*frame)

    watcher.extrapolated = made
    game.step = lambda: (step(), remember())
    seen, images = game.while_running(lambda: in_the_midst.wait(PATIENCE) and see(program, "final", "warp.color"))
    game.step()
    time_of = seen.moment.time - 1 / 60
    expected = next(color for time, color in colors.items() if abs(time - time_of) < 1e-6)
    assert np.array_equal(images["final"][..., :3], expected)
    assert images["warp.color"].shape == (H, W, 4) and seen.moment.alpha == pytest.approx(0.5)
    assert not np.array_equal(images["warp.color"], images["final"])
    assert seen.kernels["warp"] and sum(seen.kernels["warp"].values()) > 0
    assert seen.pacing is not None and "frame.filled_by" in program.specs
    kinds = game.while_running(lambda: {see(program, "final", generated=False)[0].moment.alpha > 0 for _ in range(8)})
    assert kinds == {False, True}
    program.close()


@pytest.mark.device
def test_story(game):
    program = RunningProgram(NAME, 0)
    game.while_running(lambda: see(program, "final"))  # a program that generates frames is asked of these
    told = game.while_running(lambda: program.inspect(50, 50, None, lambda: None))
    assert told.pixel == (50, 50) and told.story.sentences[0].startswith("Shown by its own fragment")
    assert "history.dynamic_mask" in told.values
    program.close()


@pytest.mark.device
def test_options_are_switched_in_the_program(game):
    program = RunningProgram(NAME, 0)

    def dynamic():
        """Whether anything is dynamic in the next generated frame: the first look may come at a rendered one."""
        seen, images = see(program, "frame.dynamic")
        return images["frame.dynamic"].any() if seen.moment.alpha else dynamic()

    assert game.while_running(lambda: [dynamic() for _ in range(4)])[-1]
    program.use(replace(program.options, motion=False))

    def switched():
        while see(program, "frame.dynamic")[0].options.motion:
            pass
        return dynamic()

    assert not game.while_running(switched)
    assert not game.pipeline.options.motion and not game.made.numpy("dynamic").any()
    program.close()


@pytest.mark.device
def test_recorded_frames(game, tmp_path):
    """The last ones, as they were; their copy is not touched by what the program does next."""
    program = RunningProgram(NAME, 5)
    until(lambda: game.attachment.watched, "the program to notice")
    submitted = {}
    for _ in range(9):
        game.step()
        submitted[game.frame.time] = game.frame
    sequence = until(lambda: program.recording())
    assert len(sequence.rendered) in (4, 5)  # the newest may still be copied
    assert sequence.rendered[0].reset and not sequence.rendered[1].reset
    pixels = [sequence.read(entry) for entry in sequence.rendered]
    for _ in range(5):
        game.step()
    for frame in pixels:
        given = submitted[frame.time]
        assert np.array_equal(frame.color, gffe_color(given)) and frame.camera == given.camera
        depth, motion = (np.asarray(array) for array in (given.depth, given.motion))
        assert np.array_equal(frame.depth, depth) and np.array_equal(frame.motion, motion)
    assert sequence.camera_at(sequence.rendered[1].time + 1 / 60) is not None
    program.close()


def gffe_color(frame):
    return np.asarray(frame.color)[..., :3].astype(np.float16)


class Executed:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def open_descriptors():
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.device
def test_bad_messages_end_one_viewer_only(game, tmp_path):
    hello = f"gffe-cl attach {channel.own_version()}\n".encode()
    greeting, look = encoded(wire.Greeting(3)), encoded(wire.Look(frozenset({"final"})))
    bad = (
        (b"garbage",),
        (hello[:9],),
        (b"\0" * 70000,),
        (b"gffe-cl attach 0.0.1\n", greeting),
        (hello, b"garbage"),
        (hello, look),
        (hello, greeting.replace(b"3", b"null")),
        (hello, greeting.replace(b"3", b"257")),
        (hello, greeting.replace(b"frames", b"count")),
        (hello, pickle.dumps(Executed(tmp_path / "executed"))),
        (hello, greeting, pickle.dumps(Executed(tmp_path / "executed"))),
        (hello, greeting, b"[" * 100000),
        (hello, greeting, encoded(wire.Ask(W, 0))),
        (hello, greeting, encoded(wire.Use(game.pipeline.options)).replace(b'"history":2', b'"history":200')),
        (hello, greeting, look + b"\0more"),
    )
    game.step()
    before = open_descriptors()
    for packets in bad:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as viewer:
            viewer.connect(channel.address_of(NAME))
            viewer.settimeout(PATIENCE)
            with suppress(BrokenPipeError, ConnectionResetError):
                for packet in packets:
                    socket.send_fds(viewer, [packet], [0, 1, 2])
                while viewer.recv(1 << 20):
                    pass
        game.step()
    assert not (tmp_path / "executed").exists()
    until(lambda: open_descriptors() <= before, "descriptors to be closed")
    program = RunningProgram(NAME, 3)
    assert game.while_running(lambda: see(program, "final"))[1]["final"].any()
    program.close()


@pytest.mark.device
def test_forked_children_leave_the_channel_alone(game):
    """They neither close it nor keep it open."""
    program = RunningProgram(NAME, 3)
    until(lambda: game.attachment.watched)
    sent = list(channel._sockets)
    assert len(sent) >= 3  # the listener's, and both ends of the channel
    child = os.fork()
    if child == 0:
        held = sum(one.fileno() >= 0 for one in sent)
        game.attachment.close()
        os._exit(held)
    assert os.waitpid(child, 0)[1] == 0
    assert attached() == [NAME] and game.attachment.watched
    assert game.while_running(lambda: see(program, "final"))[1]["final"].any()
    program.close()


@pytest.mark.device
def test_viewer_that_does_not_read_is_sent_away(game):
    """The program waits for nobody."""
    program = RunningProgram(NAME, 3)
    until(lambda: game.attachment.watched)
    viewer = game.attachment._watcher.viewer
    for _ in range(3):
        viewer.looks.append(wire.Look(frozenset({"no such layer"})))
        game.step()
    program.close()
    until(lambda: not game.attachment.watched)
    game.step()
    assert game.color.any()


@pytest.mark.device
def test_faults_of_looking_are_not_the_programs(game, monkeypatch):
    program = RunningProgram(NAME, 3)
    until(lambda: game.attachment.watched)
    monkeypatch.setattr(client, "device_layers", lambda *_: 1 / 0)

    def refused():
        with pytest.raises(gffe.GffeError, match=f"the program '{NAME}' has ended"):
            see(program, "final")
        return True

    assert game.while_running(refused)
    assert not game.attachment.watched and game.color.any()


@pytest.mark.device
def test_attachment_ends(device):
    pipeline = gffe.Pipeline(device, W, H, gffe.Options(shading_correction=False))
    with gffe.attach(pipeline, NAME) as attachment:
        assert attachment.name == NAME and not attachment.watched
        with pytest.raises(gffe.GffeError, match="attached already"):
            gffe.attach(pipeline, "other")
    assert pipeline.watcher is None and attached() == []
    attachment.close()
    again = gffe.attach(pipeline, NAME)
    del pipeline  # its attachment ends with it
    until(lambda: not attached(), "the socket to go")
    again.close()
    with pytest.raises(gffe.GffeError, match="attach: pipeline must be a Pipeline"):
        gffe.attach(None)


# ---- two processes ------------------------------------------------------------------------------------------------


@pytest.fixture
def program(tmp_path):
    """A program of its own, and the file that it writes into."""
    log = tmp_path / "log.txt"
    child = subprocess.Popen([sys.executable, str(PROGRAM), NAME, str(log)], stderr=subprocess.PIPE, text=True)
    child.log = log
    until(lambda: child.poll() is not None or (log.exists() and len(log.read_text().splitlines()) > 3), "its frames")
    assert child.poll() is None, child.stderr.read()
    yield child
    child.kill()
    child.wait()


class Looking:
    """The viewer without a window."""

    def __init__(self):
        self.model = Model(Settings(), save_settings=False)
        self.model.attach(NAME, 6)
        self.until(lambda: self.model.contents.result is not None)

    def until(self, happens):
        def moved():
            self.model.update(time.perf_counter(), None)
            return happens()

        return until(moved)


@pytest.fixture
def looking(program):
    looking = Looking()
    yield looking
    looking.model.close()


def left_behind():
    """Shared memory of ours that has a name."""
    return [path for path in Path("/dev/shm").glob("*gffe*")] if Path("/dev/shm").is_dir() else []


@pytest.mark.device
def test_viewer_follows_switches_and_freezes(device, program, looking, tmp_path, monkeypatch, gffe):
    model = looking.model
    assert model.follows and model.contents.result.moment.k > 0
    seen = {model.contents.result.moment.k}
    looking.until(lambda: seen.add(model.contents.result.moment.k) or len(seen) > 3)
    model.show_layer("frame.filled_by")
    model.pointing.pick((80, 50))
    looking.until(lambda: model.pointing.story and "frame.filled_by" in model.contents.result.images)
    assert model.timings.means()["warp"] > 0
    model.parameters.switch("motion", False)
    looking.until(lambda: not model.source.options.motion and model.settled)
    until(lambda: program.log.read_text().splitlines()[-1].endswith("False"), "the program's options")
    model.parameters.switch("motion", True)
    looking.until(lambda: model.source.options.motion and model.settled)
    assert model.setup.options == resolved(model.source.options)
    looking.until(lambda: len(model.program.recording().rendered) >= 5)

    model.freeze()
    looking.until(lambda: model.frozen and model.settled)
    assert model.playback.slot == model.playback.slots - 1 and model.n == 1 and model.source.count >= 5
    moment = model.contents.result.moment
    assert moment.alpha == 0.5 and moment.camera == model.source.camera(moment.k, 0.5)
    assert {"final", "warp.color"} <= model.contents.result.specs.keys()
    time.sleep(0.2)  # the program goes on, the frozen moment does not
    looking.until(lambda: model.settled)
    assert model.contents.result.moment == moment

    monkeypatch.chdir(tmp_path)
    model.saving.start(lambda subject: RecordingWork(subject, model.recording))
    looking.until(lambda: model.saving.work is None)
    assert (tmp_path / f"{NAME}_recorded" / "sequence.json").exists()
    code, said, _ = gffe("check", f"{NAME}_recorded")
    assert code == 0 and "rendered frames, 160×96" in said
    model.follow()
    looking.until(lambda: model.follows and model.contents.result is not None)
    assert model.contents.result.moment.k > moment.k


@pytest.mark.device
def test_program_is_killed(device, program, looking):
    """The viewer goes on with the last frames, and nothing is left."""
    model = looking.model
    looking.until(lambda: len(model.program.recording().rendered) >= 4)
    os.kill(program.pid, signal.SIGKILL)
    program.wait()
    looking.until(lambda: model.frozen and model.settled)
    assert model.source.count >= 4 and "has ended" in model.messages[-1].text and "L follows" in model.states[0]
    assert left_behind() == []
    assert channel.Listener("another", "stem").close() is None  # whoever comes next cleans up
    assert attached() == []
    source = model.source
    model.follow()
    looking.until(lambda: f"no program is attached as '{NAME}'" in model.messages[-1].text)
    again = subprocess.Popen([sys.executable, str(PROGRAM), NAME, str(program.log)])
    try:
        until(attached, "the next program")
        model.update(time.perf_counter(), None)
        assert model.source is source and not model.busy, "the last frames are kept"
        model.follow()
        looking.until(lambda: model.follows and model.contents.result is not None)
    finally:
        again.kill()
        again.wait()


@pytest.mark.device
def test_program_that_answers_late(device, program, tmp_path):
    """The interface goes on meanwhile; whoever opens something else does not lose it."""
    model = Model(Settings(), save_settings=False)
    os.kill(program.pid, signal.SIGSTOP)
    try:
        with pytest.raises(gffe.GffeError, match=f"{NAME}: no answer"):
            RunningProgram(NAME)
        start = time.monotonic()
        model.attach_to(f" {NAME} ")
        job = model._attaching
        assert time.monotonic() - start < 2 and model.busy and not model.messages
        until(job.running)
        model.open("corridor")
        os.kill(program.pid, signal.SIGCONT)
        assert isinstance(job.result(), RunningProgram)
        until(lambda: model.update(time.perf_counter(), None) or model.source is not None)
        assert model.source.name == "corridor" and model.program is None
        until(lambda: job.result().ended, "that it is left")
    finally:
        os.kill(program.pid, signal.SIGCONT)
        model.close()


@pytest.mark.device
def test_viewer_is_killed(device, program):
    """The program goes on, and the next viewer can look."""
    look = (
        f"from gffe_cl.viewer.engine.sources.program import RunningProgram; p = RunningProgram({NAME!r})\n"
        "while True: p.see(frozenset({'final'}), False, lambda: None); print('seen', flush=True)"
    )
    viewer = subprocess.Popen([sys.executable, "-c", look], stdout=subprocess.PIPE, text=True)
    for _ in range(3):
        assert viewer.stdout.readline() == "seen\n"
    viewer.kill()
    viewer.wait()
    count = len(program.log.read_text().splitlines())
    until(lambda: len(program.log.read_text().splitlines()) > count + 5, "frames after the viewer's death")
    assert left_behind() == [] and attached() == [NAME]
    again = RunningProgram(NAME, 3)
    assert see(again, "final")[1]["final"].any()
    again.close()
    assert program.poll() is None


def test_command_line(gffe):
    for words, expected in (
        (["--attach", "x", "corridor"], "expected no sequence or scene in addition"),
        (["--attach", "x", "--last", "2"], "--last must be 3 to 256"),
        (["--attach", "x", "--measure", "1"], "exclude each other"),
    ):
        code, _, said = gffe("view", *words)
        assert code == 2 and expected in said and said.count("\n") == 1
