"""A game on Panda3D, rendered at 15 Hz and shown at 30 or more: gffe-cl makes the frames between.

    python docs/examples/panda3d_live.py                          a window; --rate 30 --shown 60
    python docs/examples/panda3d_live.py --game                   frames as games have them, see `Game`
    python docs/examples/panda3d_live.py --offscreen --measure --frames 12

The mouse moves the camera. Keys: G generation, N network, V adaptive window on and off; L next layer; C cut;
X lose the next rendered frame. docs/tutorial_live.md explains each part, docs/threads.md why there is one thread.
"""

from json import dumps
from pathlib import Path
from time import perf_counter, sleep

import numpy as np
import typer
from direct.actor.Actor import Actor
from direct.gui.OnscreenImage import OnscreenImage
from direct.gui.OnscreenText import OnscreenText
from direct.showbase.ShowBase import ShowBase
from panda3d import core
from scipy import ndimage

import gffe_cl as gffe

SHADERS = [Path(__file__).with_suffix(end) for end in (".vert", ".frag")]
SETTINGS = "audio-library-name null\nsync-video 0\ntextures-power-2 none\nnotify-level error\nnotify-level-device fatal"
SWITCHES = {"g": "generate", "n": "network", "v": "window", "x": "lose", "c": "cut"}
TO_YUP = core.LMatrix4f.convertMat(core.CS_zup_right, core.CS_yup_right)


class Game:
    """A panda that walks in a circle. `game`: half-size jittered depth and motion, color with TAA, a HUD as a layer."""

    def __init__(self, size, offscreen=False, game=False):
        display = "load-display p3headlessgl" if offscreen else ""
        core.loadPrcFileData("", f"{SETTINGS}\nwin-size {size[0]} {size[1]}\n{display}")
        self.base = base = ShowBase(windowType="offscreen" if offscreen else "onscreen")
        self.generate, self.network, self.window, self.lose = True, True, False, False
        self.layer, self.side, self.game, self.count, self.hud = 0, 1, game, 0, None
        self.jitter = gffe.Jitter(16 if game else 1)
        self.scene = core.NodePath("scene")
        self.scene.setTransparency(core.TransparencyAttrib.M_none, 1)
        self.scene.setShader(core.Shader.load(core.Shader.SL_GLSL, *SHADERS))
        self.scene.setShaderInput("moved", core.LMatrix4f.identMat())
        environment = self.scene.attachNewNode(base.loader.loadModel("models/environment").node())
        environment.setPosHprScale(-8, 42, 0, 0, 0, 0, 0.25, 0.25, 0.25)
        self.panda = Actor("models/panda-model", {"walk": "models/panda-walk4"})
        self.panda.reparentTo(self.scene)
        self.panda.setScale(0.006)
        self.panda.setBlend(frameBlend=True)
        self.mesh = self.panda.find("**/+GeomNode").node()
        self.posed = self.mesh.getGeom(0).getVertexData()
        layout = core.GeomVertexFormat(core.GeomVertexFormat.getV3n3t2())
        layout.addArray(core.GeomVertexArrayFormat("shift", 3, core.Geom.NT_float32, core.Geom.C_other))
        self.layout = core.GeomVertexFormat.registerFormat(layout)
        self.lens = core.MatrixLens()
        self.camera = self.scene.attachNewNode(core.Camera("camera", self.lens))
        self.targets = [self.target((0.35, 0.5, 0.7, 0), self.camera) for _ in range(1 + game)]
        if game:
            hud, seen = core.NodePath("hud"), core.Camera("hud", core.OrthographicLens())  # from -½ to ½
            self.text = OnscreenText(parent=hud, pos=(-0.3, -0.45), scale=(0.03, 0.05), fg=(1, 1, 1, 1))
            self.text.setFluidY(5)  # before the lens
            self.targets.append(self.target((0, 0, 0, 0), hud.attachNewNode(seen)))
        self.picture = core.Texture("picture")
        OnscreenImage(self.picture, parent=base.render2d)
        for key, name in SWITCHES.items():
            base.accept(key, self.switch, [name])
        base.accept("l", lambda: setattr(self, "layer", self.layer + 1))
        self.resize(size)

    def target(self, clear, camera):
        """Return an offscreen target for what `camera` sees, with its textures: color, and depth with motion."""
        floats = core.FrameBufferProperties()
        floats.setFloatColor(True)
        floats.setRgbaBits(32, 32, 32, 32)
        floats.setAuxFloat(1)
        floats.setDepthBits(24)
        planes = core.Texture("color"), core.Texture("geometry")
        target = self.base.win.makeTextureBuffer("target", 16, 16, planes[0], True, floats)
        target.addRenderTexture(planes[1], core.GraphicsOutput.RTM_copy_ram, core.GraphicsOutput.RTP_aux_float_0)
        target.setClearColor(clear)
        target.makeDisplayRegion().setCamera(camera)
        return target, *planes

    def switch(self, name):
        setattr(self, name, name == "cut" or not getattr(self, name))
        self.side *= -1 if name == "cut" else 1
        if name == "network":
            self.resize(self.size)

    def resize(self, size):
        """Make everything anew for images of `size`, with the network or without."""
        self.size, self.cut = size, True
        self.geometry_size = tuple((n + 1) // 2 for n in size) if self.game else size
        for (target, *_), pixels in zip(self.targets, (size, self.geometry_size, size), strict=False):
            target.setSize(*pixels)
        self.scene.setShaderInput("size", core.LVecBase2f(*self.geometry_size))
        self.pipeline = gffe.Pipeline(gffe.open_device(), *size, gffe.Options(shading_correction=self.network))

    def look(self, now):
        """Move the camera to where it is at `now`, and return it as gffe-cl takes it."""
        turn, rise, mouse = 0.35 * now + self.side, 0, self.base.mouseWatcherNode
        if mouse and mouse.hasMouse():
            turn, rise = 2 * mouse.getMouseX() * self.side, 2 * mouse.getMouseY()
        self.camera.setPos(9 * np.sin(turn), -13 + 3 * np.cos(0.5 * now), 2.6 + rise)
        self.camera.lookAt(np.sin(now), 0, 2)
        _, forward, up, place = np.array(self.camera.getMat(self.scene))[:, :3]
        width, height = self.size
        return gffe.Camera.from_pose(place, forward, up, 0.866 * width, 0.866 * width, width / 2, height / 2)

    def lens_of(self, camera):
        projection = camera.projection_matrix("opengl", *self.size, near=0.2, far=3000)
        return TO_YUP * core.LMatrix4f(*projection.T.ravel())  # Panda3D's are for row vectors

    def antialiased(self, color, motion):
        """Return `color` (H, W, 3) blended into that of the frame before, which follows the geometry's motion."""
        scale, pixels = np.divide(self.size, self.geometry_size), np.indices(color.shape[:2])
        rows, columns = (pixels / scale[::-1, None, None]).astype(int)
        place = pixels + np.moveaxis(scale * motion[rows, columns], 2, 0)[::-1]
        old = [ndimage.map_coordinates(self.history[..., k], place, order=1, mode="nearest") for k in range(3)]
        around = (fitting(color, (3, 3, 1)) for fitting in (ndimage.minimum_filter, ndimage.maximum_filter))
        return (0.85 * np.clip(np.stack(old, -1), *around) + 0.15 * color).astype(np.float32)

    def draw(self, now, camera, jittered=None):
        """Return color (H, W, 3), depth (H, W) and motion (H, W, 2) of the scene at `now`, seen by `camera`, or by the
        `jittered` one, but motion has no jitter."""
        self.panda.setPosHpr(3 * np.cos(0.7 * now), 3 * np.sin(0.7 * now), 0, np.degrees(0.7 * now) + 180, 0, 0)
        self.panda.pose("walk", 36 * now % (self.panda.getNumFrames("walk") - 1))
        self.panda.update(force=True)
        posed = self.posed.animateVertices(True, core.Thread.getCurrentThread())
        skin = core.GeomVertexData(posed.convertTo(self.layout))
        vertices = np.frombuffer(skin.getArray(0).getHandle().getData(), np.float32).reshape(-1, 8)[:, :3]
        self.lens.setUserMat(self.lens_of(jittered or camera))
        clip = self.scene.getMat(self.camera) * self.lens_of(camera)
        self.latest = vertices, core.LMatrix4f(self.panda.getMat()), clip
        old_vertices, old_place, old_clip = self.latest if self.cut else self.kept
        skin.modifyArrayHandle(1).setData((old_vertices - vertices).tobytes())
        self.mesh.modifyGeom(0).setVertexData(skin)
        self.panda.setShaderInput("moved", core.invert(self.panda.getMat()) * old_place)
        lamp = 4 * np.cos(2 * now), 4 * np.sin(2 * now), 2.5
        self.scene.setShaderInputs(present_clip=clip, previous_clip=old_clip, lamp=lamp)
        if self.game:
            self.text.setText(f"PANDA   {3 * now:.0f} m")
        for target, *_ in self.targets:
            target.setOneShot(True)
        self.base.graphicsEngine.renderFrame()
        planes = [plane for _, *textures in self.targets for plane in textures]
        memory = [np.frombuffer(plane.getRamImageAs("RGBA"), np.float32) for plane in planes]
        images = [m.reshape(p.getYSize(), p.getXSize(), 4)[::-1] for m, p in zip(memory, planes, strict=True)]
        color, drawn, geometry = images[0], *images[2 * self.game :][:2]
        self.hud = images[4][..., :1].repeat(4, 2) if self.game else None  # white: color and alpha are alike
        geometry = np.where(drawn[..., 3:] > 0, geometry, np.float32([np.inf, 0, 0, 0]))  # nothing was drawn: the sky
        return color[..., :3], geometry[..., 0], geometry[..., 1:3]

    def render(self, now):
        """Render and submit the frame of `now`, through a window where wanted, and return it; None if it is lost."""
        camera = rendered = self.look(now)
        if self.window and not self.cut:
            window = gffe.adaptive_window(camera, gffe.predict_camera(self.shown, camera, 1), distance=4)  # units
            rendered = window.camera(camera, self.size)
        self.count += 1
        jittered = self.jitter.camera(rendered, self.count)
        color, depth, motion = self.draw(now, rendered, jittered)
        color = self.antialiased(color, motion) if self.game and not self.cut else color
        shift = np.subtract((jittered.cx, jittered.cy), (rendered.cx, rendered.cy)) * self.geometry_size / self.size
        given = {"overlays": gffe.Overlays(ui=self.hud), "geometry_jitter": shift, "geometry_size": self.geometry_size}
        frame = gffe.RenderedFrame(color, depth, motion, rendered, now, display_camera=camera, reset=self.cut, **given)
        if self.lose and not self.cut:
            self.lose = False
            return None  # what was kept stays: motion of the next frame leads to the last one that arrived
        self.kept, self.cut, self.shown, self.history = self.latest, False, camera, color
        self.pipeline.submit(frame)
        return frame

    def generated(self, moment, camera):
        """Return linear color (H, W, 3) of `moment` seen by `camera`; of the last frame if generation is off."""
        made = self.pipeline.extrapolate(camera, moment) if self.generate else self.pipeline.present()
        return made.numpy("color")

    def show(self, image):
        """Show linear color (H, W, 3), or the layer chosen in its place."""
        layers = [None, *self.pipeline.named_buffers()]
        if chosen := layers[self.layer % len(layers)]:
            values = np.nan_to_num(np.abs(chosen[0].read(chosen[1].name).astype(np.float32)), posinf=0)
            image = np.dstack(3 * [np.atleast_2d(values)])[..., :3] / max(np.percentile(values, 99), 1e-6)
        pixels = (255 * gffe.to_display(image)[::-1] + 0.5).astype(np.uint8)
        self.picture.setup2dTexture(*pixels.shape[1::-1], core.Texture.T_unsigned_byte, core.Texture.F_rgb)
        self.picture.setRamImageAs(pixels.tobytes(), "RGB")
        self.base.taskMgr.step()


def play(game, rate, shown, frames):
    pacer, due = gffe.Pacer(shown), 0.0
    for count in range(1, frames + 1):
        size = game.base.win.getXSize(), game.base.win.getYSize()
        if size != game.size and min(size) > 15:
            game.resize(size)
        now = perf_counter()
        if now >= due or game.cut:
            due = max(due + 1 / rate, now)
            if frame := game.render(now):
                pacer.rendered(frame.time, frame.reset)
            rendering = perf_counter() - now
        plan = pacer.plan(now := perf_counter())
        if not plan.held:
            image = game.generated(plan.time, game.look(now))  # the newest camera: the frame is warped to it
            generating = perf_counter() - now
        pacer.ready(perf_counter())
        sleep(max(plan.refresh - perf_counter(), 0))
        game.show(image)
        if count % 30 == 0:
            print(f"render {1e3 * rendering:.1f} ms, generate {1e3 * generating:.1f} ms,", pacer.statistics)


def figures(game, rate, shown, frames):
    """Return mean PSNR, dB, of frames between rendered ones against the same moments really rendered."""
    found = {"repeat": [], "gffe": [], "gffe_network": []}
    for name in ("gffe", "gffe_network"):
        game.network = name == "gffe_network"
        game.resize(game.size)
        for k in range(frames):
            game.render(k / rate)
            for moment in k / rate + np.arange(1, shown // rate) / shown if k > 1 else ():
                camera = game.look(moment)
                jittered = [game.jitter.camera(camera, j) for j in range(game.jitter.length)]
                truth = np.mean([game.draw(moment, camera, one)[0] for one in jittered], 0)
                truth = truth if game.hud is None else truth + game.hud[..., :3] * (1 - truth)
                repeated, made = game.pipeline.present().numpy("color"), game.generated(moment, camera)
                for key, image in {"repeat": repeated, name: made}.items():
                    found[key].append(gffe.psnr(gffe.to_display(image), gffe.to_display(truth)))
    return {key: float(np.mean(values)) for key, values in found.items()}


def main(
    rate: int = 15,
    shown: int = 30,
    frames: int = 0,
    offscreen: bool = False,
    measure: bool = False,
    game: bool = False,
):
    made = Game((480, 270), offscreen, game)
    if not measure:
        return play(made, rate, shown, frames or 10**9)
    print(dumps(figures(made, rate, shown, frames or 30)))


if __name__ == "__main__":
    typer.run(main)
