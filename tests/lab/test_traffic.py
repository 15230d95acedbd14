"""Bytes per pixel that must move, from the declarations of the stages."""

import pytest
from twin_cases import frames

from gffe_cl import Options, Pipeline
from gffe_cl.engine.opencl.program import parse_constants, parse_kernels
from gffe_cl.engine.stages.base import Access, Kernel, Stage
from gffe_cl.engine.stages.connectivity import Connectivity
from gffe_cl.engine.timing import traffic

W, H = 64, 48


def counted(device, **options):
    pipeline = Pipeline(device, W, H, Options(**options), int64_atomics=True if device.int64_atomics else None)
    shown = list(frames(W, H, spoil=False))
    for frame in shown[:-1]:
        pipeline.submit(frame)
    launches = traffic.launches_of(pipeline, lambda: pipeline.submit(shown[-1]))
    new = traffic.launches_of(pipeline, lambda: pipeline.extrapolate(shown[-1].camera, shown[-1].time + 0.01))
    launches = {name: launches[name] + new[name] for name in launches}
    shares = traffic.counters(pipeline)
    return pipeline, shares, traffic.bytes_per_pixel(pipeline, launches, shares)


def test_bytes_per_pixel_are_those_of_the_buffers(device):
    """Counted by hand: prediction reads depth, mask, where dynamic fragments were and how their cells accelerate, and
    writes a position; …"""
    _, shares, moved = counted(device, levels=0, hole_filling="none")
    assert 0.05 < shares["dynamic"] < 0.5 and "remembered" not in shares  # nothing reads what there is not
    assert moved["prediction"]["predict_positions"] == pytest.approx(
        4 + 1 + (8 + 4 + 2) * shares["dynamic"] + 12, rel=1e-2
    )
    assert moved["connectivity"]["find_links"] == pytest.approx(4 + 1 + 1 + 4 / 32)
    key = 8  # one of 64 bits, or key and winner
    splats = 1 if device.int64_atomics else 2
    block = -(-W // 8) * -(-H // 4) / (W * H)  # blocks per pixel
    splatted, splatting = shares["splatted"], shares["splatting"]
    per_splat = (4 + 1 + 12) * splatting + 2 * key * splatted + (8 + 1) * block
    assert moved["warp"]["splat"] == pytest.approx(splats * per_splat, rel=1e-3)
    shown = 12 + 8 + 1 + (8 + 4 + 8 + 4 * 1)
    per_pixel = shown + (key + 4 + 1) * splatted + key * shares["mixed"] + (32 + 1) * block
    assert moved["warp"]["resolve"] == pytest.approx(per_pixel, rel=1e-3)


def test_levels_and_shares_count(device):
    """Deeper levels are smaller; what is done for a share of the pixels costs that share."""
    _, shares, one = counted(device, levels=1)
    once, twice = (moved["background"]["scatter_level"] for moved in (one, counted(device, levels=2)[2]))
    assert once < twice < 2 * once
    fill = one["holes"]["fill_far_side"]
    block = -(-W // 8) * -(-H // 4) / (W * H)
    shown = shares["splatted"] + block
    lines = 3 * 4 * shares["border"] * -(-W // 8) * -(-H // 8) / (W * H)
    assert fill == pytest.approx(shown + shares["unfilled"] * ((8 + 4) * 3 + 1 + 8) + lines, rel=0.02)


def test_memory_is_what_was_allocated(device):
    before = device.allocated
    pipeline = Pipeline(device, W, H, Options(shading_inputs=True, history=3))
    assert sum(traffic.memory(pipeline).values()) == device.allocated - before


@pytest.mark.parametrize("options", [{}, {"hole_filling": "downsample", "upscale": 1.0, "levels": 0}])
def test_all_declared_kernels_are_launched_and_counted(device, options):
    pipeline, _, moved = counted(device, **options)
    at_rest = {"encode_colors"}  # history tracking encodes colors while the camera moves
    for name, stage in pipeline.stages.items():
        assert {kernel.name for kernel in stage.kernels} - at_rest == set(moved[name]) - {"fill"}
        assert all(moved[name].values())


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
        ("width", "int", False, True), ("color", "half", True, True), ("mask", "uchar", True, False)
    ]  # fmt: skip
    assert [a.name for a in kernels["second"]] == ["nodes", "count", "zoom"]


_WRITTEN = dict.fromkeys(
    ("links", "state", "fill_keys", "fill_winners", "push_keys", "push_winners"), "connectivity.links"
)


@pytest.mark.parametrize(
    ("reads", "writes", "complaint"),
    [
        ({"depth": "rendered.depth"}, _WRITTEN, "declared"),
        ({"depth": "rendered.depth", "mask": "history.dynamic_mask"}, _WRITTEN, "declared"),
        (
            {"depth": "rendered.depth", "last_stir": "history.last_stir"},
            _WRITTEN | {"dynamic_mask": Access("history.dynamic_mask")},
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
    pipeline = counted(device)[0]
    stage = pipeline.stages["warp"]
    with pytest.raises(TypeError, match=r"kernels/warp.cl.*'frame'"):
        stage.launch("resolve", unfilled_label=0)
