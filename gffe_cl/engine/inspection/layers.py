"""Layers: the images of a frame and of every stage, by name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.inspection import names
from gffe_cl.engine.pipeline.outputs import Output
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Stage
from gffe_cl.engine.stages.buffers import RENDERED, RGBA, XY, BufferSpec, ExtrapolatedBuffers, Owner
from gffe_cl.engine.stages.presentation import Presentation
from gffe_cl.engine.stages.upload import Upload

VIEWS = ("color", "depth", "motion", "place", "world", "mask", "label", "scalar")
FRAME_GROUP = "frame"
_LIMITS = {"focus_mask": (0.0, 1.0)}  # by the buffer's name
NATIVE = {"color": "RGB", "motion": "vector", "place": "vector", "world": "distance"}  # displayed part of all channels


@dataclass(frozen=True)
class LayerSpec:
    """One image that can be shown.

    `name` is "final", "rendered.color" … or "<stage>.<buffer>"; `group` heads it in lists. `view`, `components`,
    `planes`, `labels`, `grid` are those of `BufferSpec`. The positions of a "place" are `places_in` pixels of the
    "rendered" or the "target" image. `limits`: of a scalar's usual range; None: fitted to the picture.
    `of_generated`: made for generated frames only; a rendered one has none. `bits`: meanings of the bits of a number.
    """

    name: str
    label: str
    group: str
    view: str
    components: tuple[str, ...] = ()
    planes: int = 1
    labels: tuple[tuple[int, str], ...] = ()
    description: str = ""
    grid: str = "target"
    places_in: str = "rendered"
    limits: tuple[float, float] | None = None
    of_generated: bool = False
    bits: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Choices of `Display.channel`, the usual one first."""
        native = NATIVE.get(self.view)
        return (native, *self.components) if native else self.components or ("value",)


FRAME_BUFFERS: dict[str, BufferSpec] = {
    spec.name: spec
    for spec in (
        BufferSpec(names.FINAL, np.float16, RGBA, "target", "displayed image at this time, linear RGB", "color"),
        *(replace(spec, name=f"rendered.{spec.name}") for spec in RENDERED),
        BufferSpec(names.GAE, np.float16, RGBA, "target", "extrapolated, before shading correction", "color"),
        BufferSpec(
            names.TRUTH,
            np.float16,
            RGBA,
            "target",
            "ground truth: the rendered image at this time, linear RGB",
            "color",
        ),
        BufferSpec(
            names.FOCUS_TRUTH,
            np.uint8,
            (),
            "target",
            "static, and unlike the truth around (M_focus: SMAPE > 0.5)",
            "mask",
        ),
        BufferSpec(
            names.UNDONE,
            np.float32,
            XY,
            "source",
            "vectors in use minus vectors as given, pixels: dilation or jitter undone, the camera's part added",
            "motion",
        ),
    )
}
_LINKED = "right", "down", "left", "up", "lattice"
_BITS: dict[str, tuple[str, ...]] = {names.LINKS: _LINKED, "lattices.lattices": _LINKED}
_LABELS = {
    names.RENDERED_COLOR: "Rendered color",
    names.GAE: "GAE",
    names.TRUTH: "Ground truth",
    names.FOCUS_TRUTH: "True focus mask",
    names.UNDONE: "Changed motion",
    "upload.small_depth": "Depth, own size",
    "upload.small_motion": "Motion, own size",
}


def named_images(pipeline: Pipeline, generated: bool = True) -> dict[str, tuple[BufferSpec, cl.Buffer]]:
    """Return every image that the pipeline holds, by its layer's name; without `generated` only those that it makes for
    rendered frames, too."""
    return {
        f"{owner.name}.{spec.name}": (spec, owner.buffer[spec.name])
        for owner, spec in pipeline.named_buffers()
        if spec.grid != "once" and (generated or not _only_for_generated(owner, spec))
    } | {f"{owner.name}.{spec.name}": (spec, owner.buffer[spec.name]) for owner, spec, _ in pipeline.conversions()}


def _words(name: str) -> str:
    """Return a buffer's name as people write it."""
    return name.replace("_", " ").replace(".", " ").capitalize()


def layer_of(group: str, spec: BufferSpec, name: str = "", of_generated: bool = False) -> LayerSpec:
    """Return the layer of a buffer; `group` is its owner's name."""
    name = name or f"{group}.{spec.name}"
    return LayerSpec(
        name=name,
        label=_LABELS.get(name) or _words(spec.name),
        group=group,
        view=spec.view if spec.view in VIEWS else "scalar",
        components=spec.components,
        planes=spec.planes,
        labels=spec.labels,
        description=spec.description,
        grid=spec.grid,
        places_in="target" if spec.name.startswith("target_") else "rendered",
        limits=_LIMITS.get(spec.name),
        of_generated=of_generated,
        bits=_BITS.get(name, ()),
    )


def _output_of(stage: str, spec: BufferSpec) -> LayerSpec:
    """Return the layer of what a stage has made of one of the new frame's buffers."""
    layer = layer_of(stage, spec, of_generated=True)
    return replace(layer, label=f"{layer.label} after {stage.replace('_', ' ')}")


FRAME_LAYERS = {name: layer_of(FRAME_GROUP, spec, name) for name, spec in FRAME_BUFFERS.items()}


def layers_of(pipeline: Pipeline) -> dict[str, LayerSpec]:
    """Return all layers by name: the frame's own ("gae" if it is not "final"), then those of every stage in the
    order of the pipeline, with each stage's output."""
    made = [
        layer_of(owner.name, spec, of_generated=_only_for_generated(owner, spec))
        for owner, spec in pipeline.named_buffers()
        if spec.grid != "once" and not isinstance(owner, Output)
    ]
    made += [_output_of(stage, spec) for stage, spec in pipeline.outputs()]
    made += [layer_of(owner.name, spec) for owner, spec, _ in pipeline.conversions()]
    order = [FRAME_GROUP, Upload.name, *pipeline.stages]
    made.sort(key=lambda spec: order.index(spec.group) if spec.group in order else len(order))
    own = {name: spec for name, spec in FRAME_LAYERS.items() if name != names.GAE or "correction" in pipeline.stages}
    return own | {spec.name: spec for spec in made}


def _only_for_generated(owner: Owner, spec: BufferSpec) -> bool:
    """Return whether a rendered frame leaves a buffer as it is: it does not run the network."""
    if isinstance(owner, Stage) and not isinstance(owner, Presentation):
        return type(owner).rendered is Stage.rendered or spec.grid.startswith("network")
    return isinstance(owner, (ExtrapolatedBuffers, Output))
