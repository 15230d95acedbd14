"""A game on Panda3D, rendered at 15 Hz and shown at 30 or more: gffe-cl makes the frames between.

    python docs/examples/panda3d_live.py                          a window; --rate 30 --shown 60, --size 640 360
    python docs/examples/panda3d_live.py --offscreen --frames 30  without one
    python docs/examples/panda3d_live.py --offscreen --measure --frames 12 --json figures.json

Keys: W A S D and the arrows move and turn the camera, O starts the camera's own path again, G generation on and off, N network,
V adaptive window, L next layer, C cut, X lose the next rendered frame, Escape quit. docs/live.md explains each part.
"""

import argparse
import json
import math
import sys
import time

import numpy as np
from direct.actor.Actor import Actor
from direct.showbase.ShowBase import ShowBase
from panda3d import core

import gffe_cl as gffe

VERTEX = """#version 330
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelViewMatrix, p3d_ModelMatrix, previous_clip, moved;
uniform float skinned;
in vec4 p3d_Vertex; in vec3 p3d_Normal, before; in vec2 p3d_MultiTexCoord0;
out vec4 clip, old_clip; out vec3 world, normal; out vec2 uv; out float depth;
void main() {
    clip = gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
    old_clip = previous_clip * moved * p3d_ModelMatrix * (skinned > 0 ? vec4(before, 1) : p3d_Vertex);
    world = (p3d_ModelMatrix * p3d_Vertex).xyz;
    normal = mat3(p3d_ModelMatrix) * p3d_Normal;
    uv = p3d_MultiTexCoord0;
    depth = -(p3d_ModelViewMatrix * p3d_Vertex).z;
}"""
FRAGMENT = """#version 330
uniform sampler2D p3d_Texture0; uniform vec3 lamp; uniform vec2 size;
in vec4 clip, old_clip; in vec3 world, normal; in vec2 uv; in float depth;
layout(location = 0) out vec4 color; layout(location = 1) out vec4 geometry;
void main() {
    vec4 texel = texture(p3d_Texture0, uv);
    if (texel.a < 0.5) discard;
    vec3 n = normalize(gl_FrontFacing ? normal : -normal), to_lamp = lamp - world;
    float light = 0.35 + 0.4 * max(n.z, 0) + 60 * max(dot(n, normalize(to_lamp)), 0) / (20 + dot(to_lamp, to_lamp));
    color = vec4(depth > 500 ? vec3(0.35, 0.5, 0.7) : pow(texel.rgb, vec3(2.2)) * light, 1);  // linear
    vec2 motion = (old_clip.xy / old_clip.w - clip.xy / clip.w) * 0.5 * size * vec2(1, -1);  // pixels, y down
    geometry = vec4(depth, motion, 1);
}"""
TO_YUP = core.LMatrix4f.convertMat(core.CS_zup_right, core.CS_yup_right)
TO_ZUP = core.LMatrix4f.convertMat(core.CS_yup_right, core.CS_zup_right)


class Game:
    def __init__(self, size, offscreen=False, samples=1):
        core.loadPrcFileData("", f"audio-library-name null\nsync-video false\ntextures-power-2 none\nwin-size {size[0]} {size[1]}")
        if offscreen:
            core.loadPrcFileData("", "load-display p3headlessgl\nnotify-level error")
        self.base = base = ShowBase(windowType="offscreen" if offscreen else "onscreen")
        self.offscreen, self.samples, self.layer, self.window = offscreen, samples, 0, False
        self.network, self.generate, self.lose, self.cut, self.autopilot = True, True, False, True, True
        self.side = 1
        self.scene = core.NodePath("scene")
        self.scene.setTransparency(core.TransparencyAttrib.M_none, 1)
        self.scene.setShader(core.Shader.make(core.Shader.SL_GLSL, VERTEX, FRAGMENT))
        self.scene.setShaderInputs(moved=core.LMatrix4f.identMat(), skinned=0.0)
        environment = base.loader.loadModel("models/environment")
        environment.reparentTo(self.scene)
        environment.setPosHprScale(-8, 42, 0, 0, 0, 0, 0.25, 0.25, 0.25)
        self.sky = base.loader.loadModel("models/misc/sphere")
        self.sky.reparentTo(self.scene)
        self.sky.setScale(1000)
        self.sky.setTwoSided(True)
        self.actor = Actor("models/panda-model", {"walk": "models/panda-walk4"})
        self.actor.setBlend(frameBlend=True)
        self.posed = self.actor.find("**/+GeomNode").node()
        geom = self.posed.getGeom(0).makeCopy()  # the same triangles, with vertices of our own: now and before
        now, before = core.GeomVertexFormat.getV3n3t2().getArray(0), core.GeomVertexArrayFormat()
        for name, count in (("before", 3), ("before_normal", 3), ("before_uv", 2)):
            before.addColumn(name, count, core.Geom.NT_float32, core.Geom.C_other)
        layout = core.GeomVertexFormat()
        layout.addArray(now)
        layout.addArray(before)
        self.skin = core.GeomVertexData("skin", core.GeomVertexFormat.registerFormat(layout), core.Geom.UHDynamic)
        self.skin.setNumRows(geom.getVertexData().getNumRows())
        geom.setVertexData(self.skin)
        node = core.GeomNode("panda")
        node.addGeom(geom, self.posed.getGeomState(0))
        self.panda = self.scene.attachNewNode(node)
        self.panda.setScale(0.006)
        self.panda.setShaderInput("skinned", 1.0)
        self.panda.node().setBounds(core.OmniBoundingVolume())
        self.panda.node().setFinal(True)
        self.lens = core.PerspectiveLens()
        self.camera = self.scene.attachNewNode(core.Camera("camera", self.lens))
        self.picture = core.Texture("picture")
        card = core.CardMaker("picture")
        card.setFrameFullscreenQuad()
        base.render2d.attachNewNode(card.generate()).setTexture(self.picture)
        self.targets = None
        self.resize(size)
        for key, action in (("g", "generate"), ("n", "network"), ("v", "window"), ("x", "lose"), ("c", "cut"), ("o", "autopilot")):
            base.accept(key, self.switch, [action])
        base.accept("l", lambda: setattr(self, "layer", self.layer + 1))
        base.accept("escape", sys.exit)
        base.accept("window-event", self.resized)

    def switch(self, name):
        setattr(self, name, not getattr(self, name))
        print(f"{name}: {'on' if getattr(self, name) else 'off'}", flush=True)
        if name == "network":
            self.resize(self.size)
        if name == "cut":
            self.side = -self.side

    def resized(self, window):
        if not self.offscreen and (size := (window.getXSize(), window.getYSize())) != self.size and min(size) > 15:
            self.resize(size)

    def resize(self, size):
        """Make the targets and the pipeline for images of `size`: all that depends on it."""
        self.size, self.cut = size, True
        if self.targets:
            self.base.graphicsEngine.removeWindow(self.targets[0])
        properties = core.FrameBufferProperties()
        properties.setFloatColor(True)
        properties.setRgbaBits(32, 32, 32, 32)
        properties.setAuxFloat(1)
        properties.setDepthBits(24)
        target = self.base.graphicsEngine.makeOutput(
            self.base.pipe, "scene", -1, properties, core.WindowProperties.size(*(n * self.samples for n in size)),
            core.GraphicsPipe.BF_refuse_window, self.base.win.getGsg(), self.base.win,
        )  # fmt: skip
        color, geometry = core.Texture("color"), core.Texture("geometry")
        target.addRenderTexture(color, core.GraphicsOutput.RTM_copy_ram, core.GraphicsOutput.RTP_color)
        target.addRenderTexture(geometry, core.GraphicsOutput.RTM_copy_ram, core.GraphicsOutput.RTP_aux_float_0)
        target.makeDisplayRegion().setCamera(self.camera)
        self.targets = target, color, geometry
        self.lens.setFov(60)
        self.lens.setAspectRatio(size[0] / size[1])
        self.lens.setNearFar(0.2, 3000)
        self.projection = np.array(TO_ZUP * self.lens.getProjectionMat())
        self.scene.setShaderInput("size", core.LVecBase2f(*size))
        self.pipeline = self.make_pipeline(self.network)

    def make_pipeline(self, network):
        return gffe.Pipeline(gffe.open_device(), *self.size, gffe.Options(shading_correction=network))

    def look(self, now, seconds=0.0):
        """Move the camera: by its own path, or by the keys held for `seconds`. Return it as gffe-cl takes it."""
        if self.autopilot:
            self.camera.setPos(9 * math.sin(0.35 * now + self.side), -13 + 3 * math.cos(0.5 * now), 2.6)
            self.camera.lookAt(math.sin(now), 0, 2)
        down = getattr(self.base.mouseWatcherNode, "isButtonDown", lambda key: False)
        for name, move, turn in (("w", (0, 9, 0), 0), ("s", (0, -9, 0), 0), ("a", (-9, 0, 0), 0), ("d", (9, 0, 0), 0),
                                 ("arrow_left", (0, 0, 0), 80), ("arrow_right", (0, 0, 0), -80)):  # fmt: skip
            if down(core.ButtonRegistry.ptr().findButton(name)):
                self.autopilot = False
                self.camera.setPos(self.camera, *(seconds * m for m in move))
                self.camera.setH(self.camera.getH() + seconds * turn)
        return gffe.Camera.from_opengl(np.array(self.scene.getMat(self.camera) * TO_YUP), self.projection, self.size)

    def draw(self, now, camera):
        """Render the scene at `now` seconds: color (H, W, 3), depth (H, W), motion (H, W, 2) since the frame kept last."""
        self.actor.pose("walk", 36 * now % (self.actor.getNumFrames("walk") - 1))
        self.actor.update(force=True)
        skinned = self.posed.getGeom(0).getVertexData().animateVertices(True, core.Thread.getCurrentThread())
        vertices = bytes(skinned.convertTo(core.GeomVertexFormat.getV3n3t2()).getArray(0).getHandle().getData())
        self.panda.setPosHpr(3 * math.cos(0.7 * now), 3 * math.sin(0.7 * now), 0, math.degrees(0.7 * now) + 180, 0, 0)
        self.sky.setPos(self.camera.getPos())
        self.scene.setShaderInput("lamp", core.LVecBase3f(4 * math.cos(2 * now), 4 * math.sin(2 * now), 2.5))
        (width, height), lens = self.size, self.lens
        lens.setFilmSize(width / camera.fx, height / camera.fy)
        lens.setFocalLength(1)
        lens.setFilmOffset((width / 2 - camera.cx) / camera.fx, (camera.cy - height / 2) / camera.fy)
        clip = self.scene.getMat(self.camera) * lens.getProjectionMat()
        self.latest = vertices, clip, core.LMatrix4f(self.panda.getMat()), core.LMatrix4f(self.sky.getMat())
        old_vertices, old_clip, *old = self.latest if self.cut else self.kept
        self.skin.modifyArrayHandle(0).setData(vertices)
        self.skin.modifyArrayHandle(1).setData(old_vertices)
        self.scene.setShaderInput("previous_clip", old_clip)
        for node, matrix in zip((self.panda, self.sky), old, strict=True):
            node.setShaderInput("moved", core.invert(node.getMat()) * matrix)
        target, *textures = self.targets
        target.setActive(True)
        self.base.graphicsEngine.renderFrame()
        target.setActive(False)
        n, shape = self.samples, (height * self.samples, width * self.samples, 4)
        color, geometry = (np.frombuffer(t.getRamImageAs("RGBA"), np.float32).reshape(shape)[::-1] for t in textures)
        color = color[..., :3].reshape(height, n, width, n, 3).mean((1, 3))
        geometry = geometry[n // 2 :: n, n // 2 :: n]  # of the sample in the middle: a mean of depths is no depth
        return color, np.where(geometry[..., 0] > 500, np.float32(np.inf), geometry[..., 0]), geometry[..., 1:3]

    def render(self, now):
        """Return the frame of `now` for gffe-cl, rendered through a window if wanted; None if it is lost."""
        camera = rendered = self.look(now)
        if self.window and not self.cut:
            ahead = [gffe.predict_camera(self.shown, camera, alpha) for alpha in (0.5, 1)]
            rendered = gffe.adaptive_window(camera, ahead, size=self.size, distance=self.nearest).camera(camera, self.size)
        color, depth, motion = self.draw(now, rendered)
        frame = gffe.RenderedFrame(color, depth, motion, rendered, now, display_camera=camera, reset=self.cut)
        if self.lose:
            self.lose = False
            return None  # what was kept stays: the next frame's motion leads to the last one that arrived
        self.kept, self.cut, self.shown, self.nearest = self.latest, False, camera, gffe.nearest_depth(depth)
        return frame

    def show(self, image):
        """Show a linear color image (H, W, 3), or the layer chosen instead."""
        layers = [(owner, spec) for owner, spec in self.pipeline.named_buffers()]
        chosen = self.layer % (len(layers) + 1)
        if chosen:
            owner, spec = layers[chosen - 1]
            image = np.nan_to_num(np.abs(owner.read(spec.name).astype(np.float32)), posinf=0)
            image = np.resize(image, image.shape) if image.ndim > 2 else image.reshape(len(image), -1, 1)
            image = np.pad(image, ((0, 0), (0, 0), (0, 3)))[..., :3] / max(np.percentile(image, 99), 1e-6)
        image = np.ascontiguousarray((255 * gffe.to_display(image) + 0.5)[::-1].astype(np.uint8))
        self.picture.setup2dTexture(image.shape[1], image.shape[0], core.Texture.T_unsigned_byte, core.Texture.F_rgb)
        self.picture.setRamImageAs(image.tobytes(), "RGB")
        self.base.taskMgr.step()


def play(game, rate, shown, frames):
    pacer, begin, due, spent = gffe.Pacer(shown), time.perf_counter(), 0.0, {"render": [], "generate": []}
    count = last = 0
    while count != frames:
        now = time.perf_counter() - begin
        if now >= due:
            due = max(due + 1 / rate, now)
            if frame := game.render(now):
                game.pipeline.submit(frame)
                pacer.rendered(now)
            spent["render"].append(time.perf_counter() - begin - now)
        plan = pacer.plan(now := time.perf_counter() - begin)
        if not plan.held:
            camera, last = game.look(now, now - last), now  # the newest: generated frames are warped to it
            made = game.pipeline.extrapolate(camera, plan.time) if game.generate else game.pipeline.present()
            image = made.numpy("color")
            spent["generate"].append(time.perf_counter() - begin - now)
        pacer.ready(time.perf_counter() - begin)
        time.sleep(max(plan.refresh - (time.perf_counter() - begin), 0))
        game.show(image)
        count += 1
        if count % 30 == 0:
            print(*(f"{name} {1e3 * np.mean(times[-30:]):.1f} ms," for name, times in spent.items()), pacer.statistics)


def measure(game, rate, shown, frames):
    """Mean PSNR, dB, of frames between rendered ones, against the same moments really rendered."""
    pipelines = {"gffe": game.make_pipeline(False), "gffe_network": game.make_pipeline(True)}
    found = {"repeat": [], "gffe": [], "gffe_network": []}
    for k in range(frames):
        frame = game.render(k / rate)
        for pipeline in pipelines.values():
            pipeline.submit(frame)
        for moment in np.arange(1, shown // rate) / shown + k / rate if k > 1 else ():
            camera = game.look(moment)
            truth = gffe.to_display(game.draw(moment, camera)[0])
            images = {name: p.extrapolate(camera, moment).numpy("color") for name, p in pipelines.items()}
            for name, image in ({"repeat": frame.color} | images).items():
                found[name].append(gffe.psnr(gffe.to_display(image), truth))
    return {name: float(np.mean(values)) for name, values in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270))
    parser.add_argument("--rate", type=int, default=15, help="rendered frames per second")
    parser.add_argument("--shown", type=int, default=30, help="shown frames per second")
    parser.add_argument("--samples", type=int, default=1, help="3: antialiasing by 3×3 samples")
    parser.add_argument("--frames", type=int, default=-1, help="stop after as many")
    parser.add_argument("--json", help="file for the figures of --measure")
    for flag in ("--offscreen", "--measure"):
        parser.add_argument(flag, action="store_true")
    given = parser.parse_args()
    game = Game(tuple(given.size), given.offscreen, given.samples)
    if not given.measure:
        return play(game, given.rate, given.shown, given.frames)
    figures = measure(game, given.rate, given.shown, max(given.frames, 4))
    print(json.dumps(figures))
    if given.json:
        with open(given.json, "w") as file:
            json.dump(figures, file)


if __name__ == "__main__":
    main()
