"""Translator of version 1 of a `gffe-folder`'s description, whose buffers had keys of their own for what `FrameFormat`
says now."""

from __future__ import annotations

from typing import Any

from gffe_cl.captures.formats.capture import Keys
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_kind, require_number, shown

_KEPT = ("format", "width", "height", "fps", "exposure", "frames")
_ROWS = {"top-left": "down", "bottom-left": "up"}


def translated(document: dict[str, Any]) -> dict[str, Any]:
    """Return the description in version 2. Raises GffeError for what that has no words for."""
    keys = Keys(document, "sequence.json")
    made = {name: value for name in _KEPT if (value := keys.take(name)) is not None}
    keys.take("version")
    cameras, files, fields = dict(require_kind(keys.take("camera", {}), dict, "camera", "an object")), {}, {}
    for name, translate in (("color", _color), ("ground_truth", _color), ("depth", _depth), ("motion", _motion)):
        given = keys.take(name)
        if given is None and name == "ground_truth":
            continue
        buffer = Keys(given, name)
        entry = {key: value for key in ("file", "channels", "values") if (value := buffer.take(key)) is not None}
        if buffer.take("packing", "none") != "none" or buffer.take("array") is not None:
            raise GffeError(f"{name}: packed channels and NPZ files are no longer read (expected floats in EXR or NPY)")
        if name != "ground_truth":
            rows = _ROWS[buffer.choice("origin", _ROWS, "top-left")]
            if fields.setdefault("rows", rows) != rows:
                raise GffeError(f"{name}: origin must be that of color (expected all rows from one side)")
        entry |= translate(buffer, fields, cameras)
        buffer.done()
        files[name] = entry
    keys.done()
    return made | {"version": 2, "files": files, "frame_format": fields, "cameras": cameras}


def _color(keys: Keys, fields: dict[str, Any], cameras: dict[str, Any]) -> dict[str, Any]:
    encoding = keys.take("encoding", "linear")
    if encoding == "gamma" or _map(keys, 3) != ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)):
        raise GffeError(f"{keys.label}: color must be linear or sRGB, without offset and scale")
    if fields.setdefault("color_encoding", encoding) != encoding:
        raise GffeError(f"{keys.label}: encoding must be that of color")
    return {}


def _depth(keys: Keys, fields: dict[str, Any], cameras: dict[str, Any]) -> dict[str, Any]:
    (offset,), (scale,) = _map(keys, 1)
    encoding = keys.choice("encoding", ("linear", "distance", "inverse", "device", "logarithmic"), "linear")
    near, far, is_reversed = keys.number("near"), keys.take("far", "infinite"), keys.flag("reversed")
    if (opengl := keys.take("opengl_buffer")) is not None:
        cameras["opengl_buffer"] = opengl
    sky, sky_from = keys.number("sky"), keys.number("sky_from")
    made: dict[str, Any] = _unknown(keys, 1)
    made |= {} if sky is None else {"sky": offset + sky / scale}
    if sky_from is not None and encoding not in ("linear", "distance"):
        raise GffeError(f"depth: sky_from belongs to linear depth, not to {encoding} (expected far)")
    made |= {} if sky_from is None else {"sky_from": offset + sky_from / scale}
    stored = (offset + is_reversed / scale, offset + (not is_reversed) / scale)  # of the planes
    if encoding in ("linear", "distance"):
        sign = 1.0 if scale > 0 else -1.0
        fields |= {"depth": encoding, "depth_scale": abs(scale), "depth_range": [offset, offset + sign]}
    elif encoding == "inverse":
        fields |= {"depth": "device", "near_z": 1.0, "far_z": "infinity", "depth_range": [offset + 1 / scale, offset]}
    elif near is None and encoding == "device":
        if (offset, scale) != (0.0, 1.0):
            raise GffeError("depth: offset and scale need near and far (expected neither)")
        fields |= {"depth": "device"}
    else:
        far = "infinity" if far == "infinite" else far
        fields |= {"depth": encoding, "near_z": near or 0.0, "far_z": far, "depth_range": list(stored)}
    return made


def _motion(keys: Keys, fields: dict[str, Any], cameras: dict[str, Any]) -> dict[str, Any]:
    offset, scale = _map(keys, 2)
    direction = keys.choice("direction", ("to_previous", "from_previous", "to_next"), "to_previous")
    made = _unknown(keys, 2) | ({"to_next": True} if direction == "to_next" else {})
    if keys.choice("jitter", ("included", "removed"), "included") == "removed":
        made["without_jitter"] = True
    fields["motion_unit"] = keys.choice("unit", ("pixels", "uv", "ndc"), "pixels")
    fields["motion_direction"] = direction if direction != "to_next" else "to_previous"
    fields["motion_y"] = keys.choice("y", ("down", "up"), "down")
    fields["motion_scale"] = list(scale)
    fields["motion_offset"] = [-o * s for o, s in zip(offset, scale, strict=True)]
    return made


def _map(keys: Keys, count: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return offset and scale of a buffer with `count` components."""
    offset, scale = (_numbers(keys, key, count, default) for key, default in (("offset", 0.0), ("scale", 1.0)))
    if 0.0 in scale:
        raise GffeError(f"{keys.label}, scale must not be 0")
    return offset, scale


def _numbers(keys: Keys, key: str, count: int, default: float) -> tuple[float, ...]:
    value = keys.take(key, default)
    values = value if isinstance(value, list) else [value] * count
    if len(values) != count:
        raise GffeError(f"{keys.label}, {key} must be a number or {count} of them, got {shown(value)}")
    return tuple(require_number(one, f"{keys.label}, {key}") for one in values)


def _unknown(keys: Keys, count: int) -> dict[str, Any]:
    """Return the keys about values that were never written."""
    made = {key: value for key in ("valid", "unknown_from") if (value := keys.take(key)) is not None}
    if (given := keys.take("unknown")) is not None:
        values = given if isinstance(given, list) else [given]
        if len({*map(str, values)}) != 1:
            raise GffeError(f"{keys.label}, unknown must be one number, got {shown(given)}")
        made["unknown"] = values[0]
    return made
