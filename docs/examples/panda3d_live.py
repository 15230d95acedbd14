"""A game on Panda3D, rendered at 15 Hz and shown at 30 or more: gffe-cl makes the frames between.

    python docs/examples/panda3d_live.py                          a window; --rate 30 --shown 60, --size 640 360
    python docs/examples/panda3d_live.py --offscreen --frames 30  without one
    python docs/examples/panda3d_live.py --offscreen --measure --frames 12 --json figures.json

Keys: W S walk, A D turn, O the camera's own path again; G generation, N network, V adaptive window on and off;
L next layer; C cut; X lose the next rendered frame; Escape quit. docs/tutorial_live.md explains each part.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
from direct.actor.Actor import Actor
from direct.showbase.ShowBase import ShowBase
from panda3d import core

import gffe_cl as gffe

SHADERS = [Path(__file__).with_suffix(end) for end in (".vert", ".frag")]
SWITCHES = {"g": "generate", "n": "network", "v": "window", "x": "lose", "c": "cut", "o": "autopilot"}
STEPS = {"w": (9, 0), "s": (-9, 0), "a": (0, 80), "d": (0, -80)}  # units and degrees per second
TO_YUP = core.LMatrix4f.convertMat(core.CS_zup_right, core.CS_yup_right)
TO_ZUP = core.LMatrix4f.convertMat(core.CS_yup_right, core.CS_zup_right)
Output = core.GraphicsOutput


class Game:
    def __init__(self, size, offscreen=False, samples=1):
        core.loadPrcFileData("", "audio-library-name null\nsync-video false\ntextures-power-2 none")
        core.loadPrcFileData("", f"win-size {size[0]} {size[1]}")
        if offscreen:
            core.loadPrcFileData("", "load-display p3headlessgl\nnotify-level error\nnotify-level-device fatal")
        self.base = base = ShowBase(windowType="offscreen" if offscreen else "onscreen")
        self.offscreen, self.samples, self.layer, self.side, self.target = offscreen, samples, 0, 1, None
        self.network = self.generate = self.cut = self.autopilot = True
        self.window = self.lose = False
        self.scene = core.NodePath("scene")
        self.scene.setTransparency(core.TransparencyAttrib.M_none, 1)
        self.scene.setShader(core.Shader.load(core.Shader.SL_GLSL, *SHADERS))
        self.scene.setShaderInputs(moved=core.LMatrix4f.identMat(), skinned=0.0)
        ground, self.sky = self.scene.attachNewNode("ground"), self.scene.attachNewNode("sky")
        ground.setPosHprScale(-8, 42, 0, 0, 0, 0, 0.25, 0.25, 0.25)
        base.loader.loadModel("models/environment").reparentTo(ground)
        base.loader.loadModel("models/misc/sphere").reparentTo(self.sky)
        self.sky.setScale(1000)
        self.sky.setTwoSided(True)
        self.actor = Actor("models/panda-model", {"walk": "models/panda-walk4"})
        self.actor.setBlend(frameBlend=True)
        self.posed = self.actor.find("**/+GeomNode").node()
        geom = self.posed.getGeom(0).makeCopy()  # the same triangles, with vertices of our own: now and before
        now, number, other = core.GeomVertexFormat.getV3n3t2().getArray(0), core.Geom.NT_float32, core.Geom.C_other
        layout = core.GeomVertexFormat(now)
        layout.addArray(core.GeomVertexArrayFormat("before", 3, number, other, "unused", 5, number, other))
        self.skin = core.GeomVertexData("skin", core.GeomVertexFormat.registerFormat(layout), core.Geom.UHDynamic)
        self.skin.setNumRows(geom.getVertexData().getNumRows())
        geom.setVertexData(self.skin)
        self.panda = self.scene.attachNewNode(core.GeomNode("panda"))
        self.panda.node().addGeom(geom, self.posed.getGeomState(0))
        self.panda.node().setBounds(core.OmniBoundingVolume())
        self.panda.setScale(0.006)
        self.panda.setShaderInput("skinned", 1.0)
        self.lens, self.picture, card = core.PerspectiveLens(), core.Texture("picture"), core.CardMaker("picture")
        self.camera = self.scene.attachNewNode(core.Camera("camera", self.lens))
        card.setFrameFullscreenQuad()
        base.render2d.attachNewNode(card.generate()).setTexture(self.picture)
        self.resize(size)
        for key, name in SWITCHES.items():
            base.accept(key, self.switch, [name])
        base.accept("l", lambda: setattr(self, "layer", self.layer + 1))
        base.accept("escape", sys.exit)
        base.accept("window-event", self.resized)

    def switch(self, name):
        setattr(self, name, name == "cut" or not getattr(self, name))
        self.side *= -1 if name == "cut" else 1
        if name == "network":
            self.resize(self.size)

    def resized(self, window):
        size = window.getXSize(), window.getYSize()
        if not self.offscreen and size != self.size and min(size) > 15:
            self.resize(size)

    def resize(self, size):
        """Make the target and the pipeline anew for images of `size`."""
        self.size, self.cut = size, True
        if self.target:
            self.base.graphicsEngine.removeWindow(self.target)
        properties, host = core.FrameBufferProperties(), self.base.win
        properties.setFloatColor(True)
        properties.setRgbaBits(32, 32, 32, 32)
        properties.setAuxFloat(1)
        properties.setDepthBits(24)
        pixels = core.WindowProperties.size(size[0] * self.samples, size[1] * self.samples)
        make, flags = self.base.graphicsEngine.makeOutput, core.GraphicsPipe.BF_refuse_window
        self.target = make(self.base.pipe, "scene", -1, properties, pixels, flags, host.getGsg(), host)
        self.textures = core.Texture("color"), core.Texture("geometry")
        for texture, plane in zip(self.textures, (Output.RTP_color, Output.RTP_aux_float_0), strict=True):
            self.target.addRenderTexture(texture, Output.RTM_copy_ram, plane)
        self.target.makeDisplayRegion().setCamera(self.camera)
        self.lens.setAspectRatio(size[0] / size[1])
        self.lens.setFov(60)
        self.lens.setNearFar(0.2, 3000)
        self.projection = np.array(TO_ZUP * self.lens.getProjectionMat())
        self.scene.setShaderInput("size", core.LVecBase2f(*size))
        self.pipeline = self.make_pipeline(self.network)

    def make_pipeline(self, network):
        return gffe.Pipeline(gffe.open_device(), *self.size, gffe.Options(shading_correction=network))

    def look(self, now, seconds=0.0):
        """Move the camera by its own path, or by the keys held for `seconds`, and return it as gffe-cl takes it."""
        is_down = getattr(self.base.mouseWatcherNode, "isButtonDown", lambda key: False)
        for key, (walk, turn) in STEPS.items():
            if is_down(core.KeyboardButton.asciiKey(key)):
                self.autopilot = False
                self.camera.setY(self.camera, seconds * walk)
                self.camera.setH(self.camera, seconds * turn)
        if self.autopilot:
            self.camera.setPos(9 * math.sin(0.35 * now + self.side), -13 + 3 * math.cos(0.5 * now), 2.6)
            self.camera.lookAt(math.sin(now), 0, 2)
        return gffe.Camera.from_opengl(np.array(self.scene.getMat(self.camera) * TO_YUP), self.projection, self.size)

    def draw(self, now, camera):
        """Return color (H, W, 3), depth (H, W) and motion (H, W, 2) of the scene at `now`, seen by `camera`."""
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
        for array, values in enumerate((vertices, old_vertices)):
            self.skin.modifyArrayHandle(array).setData(values)
        self.scene.setShaderInput("previous_clip", old_clip)
        for node, matrix in zip((self.panda, self.sky), old, strict=True):
            node.setShaderInput("moved", core.invert(node.getMat()) * matrix)
        self.target.setActive(True)
        self.base.graphicsEngine.renderFrame()
        self.target.setActive(False)
        n, shape = self.samples, (height * self.samples, width * self.samples, 4)
        color, geometry = (
            np.frombuffer(t.getRamImageAs("RGBA"), np.float32).reshape(shape)[::-1] for t in self.textures
        )
        color = color[..., :3].reshape(height, n, width, n, 3).mean((1, 3))
        geometry = geometry[n // 2 :: n, n // 2 :: n]  # the sample in the middle: a mean of depths is no depth
        return color, np.where(geometry[..., 0] > 500, np.float32(np.inf), geometry[..., 0]), geometry[..., 1:3]

    def render(self, now):
        """Return the frame of `now` for gffe-cl, through a window where wanted; None if it is lost."""
        camera = rendered = self.look(now)
        if self.window and not self.cut:
            ahead = [gffe.predict_camera(self.shown, camera, alpha) for alpha in (0.5, 1)]
            window = gffe.adaptive_window(camera, ahead, size=self.size, distance=self.nearest)
            rendered = window.camera(camera, self.size)
        color, depth, motion = self.draw(now, rendered)
        frame = gffe.RenderedFrame(color, depth, motion, rendered, now, display_camera=camera, reset=self.cut)
        if self.lose and not self.cut:
            self.lose = False
            return None  # what was kept stays: motion of the next frame leads to the last one that arrived
        self.kept, self.cut, self.shown, self.nearest = self.latest, False, camera, gffe.nearest_depth(depth)
        return frame

    def show(self, image):
        """Show linear color (H, W, 3), or the layer chosen in its place."""
        layers = [None, *self.pipeline.named_buffers()]
        if chosen := layers[self.layer % len(layers)]:
            image = np.atleast_2d(np.nan_to_num(np.abs(chosen[0].read(chosen[1].name).astype(np.float32)), posinf=0))
            image = np.pad(image.reshape(*image.shape[:2], -1), ((0, 0), (0, 0), (0, 2)))[..., :3]
            image /= max(np.percentile(image, 99), 1e-6)
        pixels = (255 * gffe.to_display(image)[::-1] + 0.5).astype(np.uint8)
        self.picture.setup2dTexture(*pixels.shape[1::-1], core.Texture.T_unsigned_byte, core.Texture.F_rgb)
        self.picture.setRamImageAs(pixels.tobytes(), "RGB")
        self.base.taskMgr.step()


def play(game, rate, shown, frames):
    pacer, begin, due, last = gffe.Pacer(shown), time.perf_counter(), 0.0, 0.0
    spent = {"render": [], "generate": []}  # seconds
    count = 0
    while count != frames:
        now = time.perf_counter() - begin
        if now >= due or game.cut:
            due = max(due + 1 / rate, now)
            if frame := game.render(now):
                game.pipeline.submit(frame)
                pacer.rendered(now)
            spent["render"].append(time.perf_counter() - begin - now)
        plan = pacer.plan(now := time.perf_counter() - begin)
        if not plan.held:
            camera, last = game.look(now, now - last), now  # the newest one: generated frames are warped to it
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
    """Return mean PSNR, dB, of frames between rendered ones against the same moments really rendered."""
    pipelines = {"gffe": game.make_pipeline(False), "gffe_network": game.make_pipeline(True)}
    found = {"repeat": [], "gffe": [], "gffe_network": []}
    for k in range(frames):
        frame = game.render(k / rate)
        for pipeline in pipelines.values():
            pipeline.submit(frame)
        for moment in k / rate + np.arange(1, shown // rate) / shown if k > 1 else ():
            truth = gffe.to_display(game.draw(moment, camera := game.look(moment))[0])
            images = {name: p.extrapolate(camera, moment).numpy("color") for name, p in pipelines.items()}
            for name, image in ({"repeat": frame.color} | images).items():
                found[name].append(gffe.psnr(gffe.to_display(image), truth))
    return {name: float(np.mean(values)) for name, values in found.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270))
    for name, default in (("rate", 15), ("shown", 30), ("samples", 1), ("frames", -1)):  # samples 3: 3×3 for a pixel
        parser.add_argument(f"--{name}", type=int, default=default)
    for name in ("--offscreen", "--measure"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    game = Game(tuple(given.size), given.offscreen, given.samples)
    if not given.measure:
        return play(game, given.rate, given.shown, given.frames)
    print(figures := json.dumps(measure(game, given.rate, given.shown, max(given.frames, 4))))
    if given.json:
        given.json.write_text(figures)


if __name__ == "__main__":
    main()
