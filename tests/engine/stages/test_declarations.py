"""What stages declare of their kernels and buffers."""

import pytest
from twin_cases import frames

from gffe_cl import Options, Pipeline
from gffe_cl.engine.opencl.program import parse_constants, parse_kernels
from gffe_cl.engine.stages.base import Kernel, Stage
from gffe_cl.engine.stages.commands import Commands
from gffe_cl.engine.stages.warp import Connectivity
from gffe_cl.engine.timing.bench import memory

W, H = 64, 48


def test_memory_is_what_was_allocated(device):
    before = device.allocated
    pipeline = Pipeline(device, W, H, Options(shading_inputs=True, history=3))
    assert sum(memory(pipeline).values()) == device.allocated - before


@pytest.mark.parametrize("options", [{"levels": 2}, {"hole_filling": "downsample", "upscale": 1.0, "levels": 0}])
def test_all_declared_kernels_are_launched(device, options, monkeypatch):
    launch, launched = Commands.launch, set()

    def noted(self, stage, made, given):
        launched.add((stage.name, made.declared.name))
        launch(self, stage, made, given)

    monkeypatch.setattr(Commands, "launch", noted)
    pipeline = Pipeline(device, W, H, Options(**options))
    *_, last = (pipeline.submit(frame) and frame for frame in frames(W, H, spoil=False))
    pipeline.extrapolate(last.camera, last.time + 0.01)
    declared = {(name, kernel.name) for name, stage in pipeline.stages.items() for kernel in stage.kernels}
    assert declared - launched <= {("color_code", "encode_colors")}  # history tracking does, while the camera moves


# ---- declarations against the source ------------------------------------------------------------------------


def test_kernels_and_constants_are_read_from_the_source():
    source = """
    #define SIDES 16   /* of a thing */
    #define SHARE 0.25f
    #define TWICE (2 * SIDES)
    #define MASK 0xFFu
    enum { PLAIN, /* no */ TILES,
           BRICKS };
    #define WORLD __global const float4 *nodes, \\
                  const int count
    // __kernel void not_this(int a) {
    __kernel __attribute__((reqd_work_group_size(64, 1, 1)))
    void first(const int width, __global const half *color /* half x4 */, __global uchar *mask) {}
    __kernel void second(WORLD, const float2 zoom) {}
    """
    assert parse_constants(source) == {"SIDES": 16, "SHARE": 0.25, "MASK": 255, "PLAIN": 0, "TILES": 1, "BRICKS": 2}
    kernels = parse_kernels(source)
    assert list(kernels) == ["first", "second"]
    assert [(a.name, a.type, a.buffer, a.read_only) for a in kernels["first"]] == [
        ("width", "int", False, True),
        ("color", "half", True, True),
        ("mask", "uchar", True, False),
    ]
    assert [a.name for a in kernels["second"]] == ["nodes", "count", "zoom"]


_WRITTEN = dict.fromkeys(("links", "levels_state", "keys", "winners"), "connectivity.links")


@pytest.mark.parametrize(
    ("reads", "writes", "complaint"),
    [
        ({"depth": "rendered.depth"}, _WRITTEN, "declared"),
        ({"depth": "rendered.depth", "mask": "history.dynamic_mask"}, _WRITTEN, "declared"),
        (
            {"depth": "rendered.depth", "last_stir": "history.last_stir", "lattices": "lattices.lattices"},
            _WRITTEN | {"dynamic_mask": "history.dynamic_mask"},
            "declared as written",
        ),
    ],
)
def test_wrong_declarations_are_refused(device, reads, writes, complaint):
    class Wrong(Stage):
        name = "connectivity"
        buffers = Connectivity.buffers
        kernels = (Kernel("find_links", "source", reads, writes),)

    pipeline = Pipeline(device, W, H)
    with pytest.raises(AssertionError, match=f"find_links: {complaint}"):
        Wrong(pipeline.board)


def test_missing_arguments_are_named(device):
    pipeline = Pipeline(device, W, H)
    stage = pipeline.stages["warp"]
    with pytest.raises(TypeError, match=r"kernels/warp.cl.*'frame'"):
        stage.launch("resolve", unfilled_label=0)
