"""What headers of files say is used, carried to new frames, or reported."""

import struct
import zlib
from fractions import Fraction

import numpy as np
import OpenEXR
import pytest
from folder_captures import rendered, write
from foreign import FPS, H, W, blender_layers, edit_json, shots, write_blender, write_exr
from png_files import chunk, png

from gffe_cl import GffeError, SequenceWriter, named_channels, open_capture, open_sequence
from gffe_cl.captures.formats.importing import import_capture
from gffe_cl.captures.sequence import FrameEntry

ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
CARRIED = {
    "chromaticities": ACES, "whiteLuminance": 100.0,
    "colorInteropID": "lin_ap0_scene", "pixelAspectRatio": 2.0,
}  # fmt: skip
NOT_CARRIED = {"owner": "somebody", "comments": "of one file", "isoSpeed": 100.0, "studio": "ours"}


def own(folder, **attributes):
    """A sequence of our own form whose headers hold `attributes`, and "frame", the number of each."""
    with SequenceWriter(folder, W, H, FPS) as writer:
        for k, shot in enumerate(rendered()):
            entry = FrameEntry(f"frame_{k}.exr", shot.time, reset=k == 0, render_camera=shot.camera)
            writer.add(entry, named_channels(shot.color, shot.depth, shot.motion))
    for k in range(3):
        rewrite(folder / f"frame_{k}.exr", frame=k, **attributes)
    return folder


def rewrite(path, **attributes):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header, held = dict(file.header()), {name: np.array(c.pixels) for name, c in file.channels().items()}
    header.pop("channels", None)
    OpenEXR.File(header | attributes, held).write(str(path))


def attributes_of(path):
    with OpenEXR.File(str(path), header_only=True) as file:
        return dict(file.header())


def assert_carried(path):
    header = attributes_of(path)
    for name, value in CARRIED.items():
        assert header[name] == value if isinstance(value, str) else np.allclose(header[name], value)
    assert not set(NOT_CARRIED) & set(header) and "frame" not in header


def test_attributes_are_carried_to_imported_and_generated_frames(gffe, tmp_path):
    folder = own(tmp_path / "in", **CARRIED, **NOT_CARRIED)
    import_capture(open_capture(folder), tmp_path / "imported", every=2)
    for path in sorted((tmp_path / "imported").glob("*.exr")):
        assert_carried(path)
    code, _, err = gffe("run", folder, tmp_path / "out", "--no-scn")
    assert code == 0 and "pixels are not square, pixelAspectRatio is 2" in " ".join(err.split())
    for path in (tmp_path / "out").glob("extrapolated_*.exr"):
        assert_carried(path)


def test_blender_and_a_folder_carry_attributes(tmp_path):
    write_blender(tmp_path / "blender", shots(), False)
    for k, shot in enumerate(shots()):
        held = {f"{layer}.{n}": c for layer, passes in blender_layers(shot).items() for n, c in passes.items()}
        write_exr(tmp_path / "blender" / f"frame_{k:04d}.exr", held, chromaticities=ACES)
    (tmp_path / "folder").mkdir()
    write(tmp_path / "folder")
    for path in (tmp_path / "folder").glob("*.exr"):
        rewrite(path, chromaticities=ACES)
    for name in ("blender", "folder"):
        np.testing.assert_allclose(open_capture(tmp_path / name).attributes["chromaticities"], ACES, rtol=1e-6)


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({"framesPerSecond": Fraction(24, 1)}, "framesPerSecond is 24 in the header, 30 in the description"),
        ({"pixelAspectRatio": 0.5}, "pixels are not square"),
        ({"compression": OpenEXR.PXR24_COMPRESSION}, "compression pxr24 approximates Z, motion.x, motion.y, which"),
    ],
)
def test_what_cannot_be_used_is_reported(tmp_path, attributes, said):
    assert open_sequence(own(tmp_path / "a")).notes == []
    assert [text for text in open_sequence(own(tmp_path / "b", **attributes)).notes if said in text]


@pytest.mark.parametrize(
    ("compression", "kind", "names", "lossy"),
    [
        ("DWAA", np.float32, ("R",), True), ("DWAB", np.float16, ("depth.R",), True),
        ("DWAA", np.float32, ("Z",), False),
        ("B44", np.float16, ("Z",), True), ("B44", np.float32, ("Z",), False), ("PXR24", np.float32, ("Z",), True),
        ("PXR24", np.float16, ("Z",), False), ("PIZ", np.float32, ("R",), False),
    ],
)  # fmt: skip
def test_depth_that_a_compression_approximates_is_reported(tmp_path, compression, kind, names, lossy):
    method = getattr(OpenEXR, f"{compression}_COMPRESSION")

    def also(folder, number, shot):
        write_exr(folder / f"d{number}.exr", {names[0]: shot.depth.astype(kind)}, compression=method)

    sequence = write(tmp_path, also=also, depth={"file": "d%d.exr", "channels": list(names)})
    assert [f"approximates {names[0]}" in text for text in sequence.notes] == [True] * lossy


def mixed(folder, form, compression):
    """A capture of a form; only its middle frame has this compression."""
    if form == "gffe-sequence":
        rewrite(own(folder) / "frame_1.exr", compression=compression)
        return "frame_1.exr"
    folder.mkdir()
    if form == "gffe-folder":

        def also(folder, number, shot):
            method = compression if number == 4 else OpenEXR.ZIP_COMPRESSION
            write_exr(folder / f"d{number}.exr", {"Z": shot.depth}, compression=method)

        write(folder, also=also, depth={"file": "d%d.exr", "channels": ["Z"]})
        return "d4.exr"
    write_blender(folder, shots(), False)
    middle = shots().index(rendered()[1])
    held = {f"{layer}.{n}": c for layer, passes in blender_layers(shots()[middle]).items() for n, c in passes.items()}
    write_exr(folder / f"frame_{middle:04d}.exr", held, compression=compression)
    return f"frame_{middle:04d}.exr"


FORMS = ("gffe-sequence", "gffe-folder", "blender")


@pytest.mark.parametrize("form", FORMS)
def test_a_compression_in_the_middle_is_reported(tmp_path, form):
    file = mixed(tmp_path / "in", form, OpenEXR.PXR24_COMPRESSION)
    (said,) = [text for text in open_capture(tmp_path / "in").notes if "approximates" in text]
    assert said.startswith(f"{file}: compression pxr24 approximates ")


@pytest.mark.parametrize("form", FORMS)
def test_a_compression_that_the_library_cannot_read_is_refused_on_opening(tmp_path, form):
    file = mixed(tmp_path / "in", form, OpenEXR.ZIP_COMPRESSION)
    path, attribute = tmp_path / "in" / file, b"compression\0compression\0\1\0\0\0"
    path.write_bytes(path.read_bytes().replace(attribute + b"\3", attribute + b"\xc8"))
    with pytest.raises(GffeError, match=rf"^{file}: compression number 200 is unknown to OpenEXR .* \(expected zip"):
        open_capture(tmp_path / "in")


def png_colors(folder, *chunks, **said):
    """The capture of test_formats_folder.py with colors as PNG, and further chunks in their headers."""

    def also(folder, number, shot):
        shown = np.clip(np.float64(shot.color), 0, 1)
        image = png((shown * 255).round().astype(np.uint8), 8, 2)
        (folder / f"c{number}.png").write_bytes(image[:33] + b"".join(chunks) + image[33:])

    return write(folder, also=also, color={"file": "c%d.png", **said})


SRGB, GAMMA = chunk(b"sRGB", b"\0"), chunk(b"gAMA", struct.pack(">I", 45455))
LINEAR = chunk(b"gAMA", struct.pack(">I", 100000))
PROFILE = chunk(b"iCCP", b"Adobe RGB (1998)\0\0" + zlib.compress(b"profile"))
PQ = chunk(b"cICP", bytes((9, 16, 0, 1)))


@pytest.mark.parametrize(
    ("chunks", "said", "curve", "note"),
    [
        ((), {}, None, None), ((SRGB, GAMMA), {}, "srgb", "sRGB, which is used"), ((GAMMA,), {}, 2.2, "gAMA: 0.45455"),
        ((LINEAR,), {}, None, None), ((SRGB,), {"encoding": "srgb"}, "srgb", None),
        ((SRGB,), {"encoding": "linear"}, None, "sRGB; colors are read as linear"),
        ((GAMMA,), {"encoding": "srgb"}, "srgb", None),
        ((LINEAR,), {"encoding": "srgb"}, "srgb", "gAMA: 1; colors are read as srgb"),
        ((PROFILE,), {"encoding": "srgb"}, "srgb", "profile Adobe RGB (1998); colors"), ((PQ,), {}, None, "cICP: PQ"),
        ((chunk(b"iCCP", b"sRGB IEC61966-2.1\0\0x"),), {}, "srgb", "profile sRGB"),
    ],
)  # fmt: skip
def test_colors_of_png(tmp_path, chunks, said, curve, note):
    sequence = png_colors(tmp_path, *chunks, **said)
    shown = np.round(np.clip(np.float64(rendered()[0].color), 0, 1) * 255) / 255
    if curve == "srgb":
        shown = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    elif curve:
        shown = shown**curve
    np.testing.assert_allclose(sequence.read_color(sequence.rendered[0]), shown, atol=1e-4)
    assert len(sequence.notes) == bool(note) and (not note or note in sequence.notes[0])


def test_primaries_of_png_are_carried(tmp_path):
    white, *others = [(0.3127, 0.329), (0.68, 0.32), (0.265, 0.69), (0.15, 0.06)]
    numbers = [round(value * 1e5) for pair in (white, *others) for value in pair]
    sequence = png_colors(tmp_path, chunk(b"cHRM", struct.pack(">8I", *numbers)))
    np.testing.assert_allclose(sequence.attributes["chromaticities"], [v for pair in (*others, white) for v in pair])


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f4", ">f4", ">f8", "<f2"])
def test_byte_and_memory_order_of_npy(tmp_path, order, kind):
    def stored(shot):
        return np.asarray(shot.motion.astype(kind), order=order)

    sequence = write(tmp_path, motion_as=stored)
    expected = rendered()[1].motion.astype(kind).astype(np.float32)
    np.testing.assert_array_equal(sequence.read(sequence.rendered[1]).motion, expected)


def test_parts_that_lie_in_several_places_are_refused(tmp_path):
    own(tmp_path / "in")
    shot = rendered()[1]
    held = named_channels(shot.color, shot.depth, shot.motion)
    parts = []
    for k, names in enumerate((("R", "G", "B"), ("Z", "motion.x", "motion.y"))):
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        window = (np.array([k, 0], np.int32), np.array([W - 1 + k, H - 1], np.int32))
        header |= {
            "dataWindow": window,
            "displayWindow": (np.array([0, 0], np.int32), np.array([W - 1, H - 1], np.int32)),
        }
        parts.append(OpenEXR.Part(header, {n: np.ascontiguousarray(held[n]) for n in names}, f"part{k}"))
    OpenEXR.File(parts).write(str(tmp_path / "in" / "frame_1.exr"))
    edit_json(tmp_path / "in" / "sequence.json", lambda said: said["frames"][1].pop("display_camera", None))
    with pytest.raises(Exception, match="parts part0, part1 have several data windows"):
        open_sequence(tmp_path / "in")
