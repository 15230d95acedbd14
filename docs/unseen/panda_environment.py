"""Panda3D's own sample content: bamboo forest and a walking panda, without antialiasing."""

from __future__ import annotations

import math

import numpy as np
from direct.actor.Actor import Actor
from panda3d.core import GeomVertexFormat, NodePath, Thread

import gffe_cl as gffe
from unseen.panda import PandaRenderer, mesh_node
from unseen.recording import Picture, noise_texture, placed, wobble

_PANDA_SCALE = 0.006
_SPEED = 2.6  # of the panda, units per second
_STRIDE = 1.6  # cycles of the walk per second


class PandaEnvironment:
    """A dolly with a pan past a panda that walks across, under a sun that turns."""

    fps = 30.0

    def __init__(self, width: int = 960, height: int = 540, frames: int = 14):
        self.width, self.height, self.frames = width, height, frames
        self._renderer = PandaRenderer(width, height, samples=1, shadow_size=90)
        scenery = self._renderer.loader.loadModel("models/environment")
        scenery.setScale(0.25)
        scenery.setPos(-8, 42, 0)
        scenery.reparentTo(self._renderer.root)
        self._renderer.add_sky(noise_texture(512, 3))
        self._actor = Actor("models/panda-model", {"walk": "models/panda-walk4"})
        self._posed: list[NodePath] = []

    def picture(self, time: float, previous: float | None) -> Picture:
        """Return what is seen at `time` (seconds), with motion since `previous`."""
        angle = 2.4 + 0.5 * time
        self._renderer.set_light(
            toward_sun=(math.cos(angle), math.sin(angle), 1.1), center=(0, 8, 0),
            color=(0.85, 0.8, 0.7), ambient=(0.38, 0.4, 0.46), fog=(0.72, 0.78, 0.84, 160), zenith=(0.25, 0.45, 0.78),
        )  # fmt: skip
        earlier = time if previous is None else previous
        for node in self._posed:
            self._renderer.forget(node)
        self._posed = [
            self._walking(time, earlier, offset, lane, phase)
            for offset, lane, phase in ((-3.2, 0.5, 0), (4.5, 6, 0.37))
        ]
        return self._renderer.picture(self._camera(time), None if previous is None else self._camera(previous))

    def close(self) -> None:
        """Release the engine."""
        self._renderer.close()

    def _camera(self, time: float) -> gffe.Camera:
        position = np.array([-2.0 + 3.0 * time, -15.0 + 4.5 * time, 2.6 + 0.1 * wobble(time, (5, 7), 1)])
        target = np.array([-3.0 + 9 * time, 4.0, 2.2])
        focal = 0.9 * self.width
        return gffe.Camera.look_at(position, target, (0, 0, 1), focal, focal, self.width / 2, self.height / 2)

    def _walking(self, time: float, earlier: float, offset: float, lane: float, phase: float) -> NodePath:
        """Return the panda as it is at `time`, with what it takes to know where each vertex was `earlier`."""
        vertices, texture, triangles = self._pose(time, phase)
        before, _, _ = self._pose(earlier, phase)
        node = self._renderer.root.attachNewNode(
            mesh_node(vertices, triangles, shift=before[:, :3] - vertices[:, :3])
        )  # fmt: skip
        node.setTexture(texture)
        now, then = (self._place(moment, offset, lane) for moment in (time, earlier))
        self._renderer.place(node, now, then)
        return node

    def _place(self, time: float, offset: float, lane: float) -> np.ndarray:
        """Return the model matrix of a panda that walks toward +x; the model looks toward −y."""
        return placed((offset + _SPEED * time, lane, 0), math.pi / 2) @ np.diag([_PANDA_SCALE] * 3 + [1])

    def _pose(self, time: float, phase: float):
        """Return vertices (position, normal, texture coordinates), texture and triangles at a moment of the walk."""
        count = self._actor.getNumFrames("walk")
        cycle = (_STRIDE * time + phase) % 1 * (count - 1)
        # Whole frames of an animation are all that Panda3D poses: mix two of them.
        low = int(cycle)
        first, texture, triangles = self._posed_at(low)
        second, _, _ = self._posed_at((low + 1) % count)
        return first + (cycle - low) * (second - first), texture, triangles

    def _posed_at(self, frame: int):
        self._actor.pose("walk", frame)
        self._actor.update(force=True)
        node = self._actor.find("**/+GeomNode")
        geom = node.node().getGeom(0)
        data = geom.getVertexData().animateVertices(True, Thread.getCurrentThread())
        data = data.convertTo(GeomVertexFormat.getV3n3t2())
        vertices = np.frombuffer(data.getArray(0).getHandle().getData(), np.float32).reshape(-1, 8).astype(float)
        whole = geom.decompose()
        triangles = np.vstack(
            [
                [
                    [part.getVertex(k) for k in range(part.getPrimitiveStart(n), part.getPrimitiveEnd(n))]
                    for n in range(part.getNumPrimitives())
                ]
                for part in whole.getPrimitives()
            ]
        )
        return vertices, node.findTexture("*") or self._actor.findTexture("*"), triangles
