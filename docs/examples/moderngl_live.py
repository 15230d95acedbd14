"""A renderer of one's own, in OpenGL: 15 rendered frames per second, shown as 60. See docs/tutorial_live.md.

python docs/examples/moderngl_live.py                           a window; Space: rendered frames only; Enter: a cut
python docs/examples/moderngl_live.py --offscreen --frames 8    mean PSNR, dB, against really rendered frames
"""

import argparse
from pathlib import Path

import glfw
import moderngl
import numpy as np
import two_threads

import gffe_cl as gffe

SIZE, RATE, SHOWN = (640, 360), 15, 60
VERTEX, FRAGMENT = (Path(__file__).with_suffix(end).read_text() for end in (".vert", ".frag"))


def models(now):
    """Yield (4, 4) model matrices and tints: a floor, and boxes that turn and travel."""
    yield np.diag([12, 0.1, 12, 1]), (0.5, 0.5, 0.45)
    for k in range(7):
        angle, matrix = now * (1 + 0.2 * k), np.eye(4)
        matrix[0, [0, 2]], matrix[2, [0, 2]] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
        matrix[:3, 3] = 4 * np.sin(k + 0.5 * now), 1.2, 1.9 * k - 7
        yield matrix @ np.diag([0.6, 1, 0.6, 1]), (0.3 + 0.1 * k, 0.9 - 0.1 * k, 0.4)


def camera_at(now, size):
    pinhole = 0.9 * size[0], 0.9 * size[0], size[0] / 2, size[1] / 2
    return gffe.Camera.look_at((9 * np.cos(0.4 * now), 4, 9 * np.sin(0.4 * now)), (0, 1, 0), (0, 1, 0), *pinhole)


def clip_from_world(camera, size):
    return camera.projection_matrix("opengl", *size, near=0.1, far=100) @ camera.view_matrix("opengl")


class Renderer:
    """A renderer with the context of `make_context`, which belongs to the thread of the first frame."""

    def __init__(self, make_context):
        self.make_context, self.size, self.context, self.cut = make_context, None, None, False

    def cuts(self, now):
        wanted, self.cut = self.cut, False
        return wanted

    def resize(self, size):
        if self.context is None:
            self.context = self.make_context()
            self.program = self.context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
            self.cube = self.context.vertex_array(self.program, [])
            self.context.enable(moderngl.DEPTH_TEST)
        planes = [self.context.texture(size, 4, dtype="f4") for _ in range(2)]
        self.size, self.target = size, self.context.framebuffer(planes, self.context.depth_renderbuffer(size))

    def frame(self, now, before, size):
        """Return the frame of `now`; its motion leads to where all was at `before` (None: a reset)."""
        if size != self.size:
            self.resize(size)
        then, camera = now if before is None else before, camera_at(now, size)
        self.target.use()
        self.target.clear(0.1, 0.2, 0.4, 0)
        self.program["lamp"] = 3 * np.cos(2 * now), 3, 3 * np.sin(2 * now)
        self.program["size"] = size
        clips = [clip_from_world(camera_at(moment, size), size) for moment in (now, then)]
        matrices = dict(zip(("clip_from_world", "old_clip_from_world"), clips, strict=True))
        for (model, tint), (old_model, _) in zip(models(now), models(then), strict=True):
            matrices |= {"world_from_model": model, "old_world_from_model": old_model}
            for name, matrix in matrices.items():
                self.program[name].write(matrix.T.astype("f4").tobytes())  # OpenGL keeps columns
            self.program["tint"] = tint
            self.cube.render(moderngl.TRIANGLE_STRIP, vertices=14)
        planes = [self.target.read(components=4, attachment=k, dtype="f4") for k in range(2)]
        color, geometry = (np.frombuffer(plane, "f4").reshape(*size[::-1], 4)[::-1] for plane in planes)
        depth = np.where(geometry[..., 3] > 0, geometry[..., 0], np.inf)  # nothing was drawn: the sky
        return gffe.RenderedFrame(color[..., :3], depth, geometry[..., 1:3], camera, now, reset=before is None)


class Window:
    """The window, which shows `frames` frames, and the hidden one whose context is the renderer's."""

    def __init__(self, shared, renderer, frames):
        self.shared, self.renderer, self.left, self.texture = shared, renderer, frames, None
        glfw.init()
        self.window = glfw.create_window(*SIZE, "gffe-cl", None, None)
        glfw.window_hint(glfw.VISIBLE, False)
        self.hidden = glfw.create_window(*SIZE, "", None, None)
        glfw.make_context_current(self.window)
        self.context = moderngl.create_context(require=330)
        glfw.set_key_callback(self.window, self.key)

    def key(self, window, key, code, action, more):
        self.renderer.cut |= key == glfw.KEY_ENTER and action == glfw.PRESS

    def renderers_context(self):
        glfw.make_context_current(self.hidden)
        return moderngl.create_context(require=330)

    def size(self):
        glfw.poll_events()
        self.shared.stopped |= bool(glfw.window_should_close(self.window)) or not self.left
        return glfw.get_framebuffer_size(self.window)

    def is_there(self):
        return min(glfw.get_framebuffer_size(self.window)) > 0 and not glfw.get_window_attrib(
            self.window, glfw.ICONIFIED
        )

    def make(self, pipeline, plan, size):
        if glfw.get_key(self.window, glfw.KEY_SPACE):
            return pipeline.present().numpy("color")
        return pipeline.extrapolate(camera_at(plan.time, size), plan.time).numpy("color")

    def show(self, image, plan):
        size = image.shape[1::-1]
        if self.texture is None or self.texture.size != size:
            self.texture = self.context.texture(size, 3, alignment=1)
            self.picture = self.context.framebuffer([self.texture])
        self.texture.write((255 * gffe.to_display(image)[::-1] + 0.5).astype("u1").tobytes())
        self.context.copy_framebuffer(self.context.screen, self.picture)
        glfw.swap_buffers(self.window)
        self.left -= 1


def measure(make_pipeline, frames):
    """Print mean PSNR of frames halfway between rendered ones: repeated, and generated."""
    renderer = Renderer(lambda: moderngl.create_context(standalone=True, require=330, backend="egl"))
    pipeline, found = make_pipeline(*SIZE), []
    for k in range(max(frames, 3)):
        frame = renderer.frame(k / RATE, (k - 1) / RATE if k else None, SIZE)
        pipeline.submit(frame)
        truth = renderer.frame((k + 0.5) / RATE, None, SIZE)
        made = pipeline.extrapolate(truth.camera, truth.time).numpy("color")
        images = [gffe.to_display(image) for image in (frame.color, made, truth.color)]
        found.append([gffe.psnr(image, images[2]) for image in images[:2]])
    print("repeat {:.2f} gffe {:.2f}".format(*np.mean(found[2:], axis=0)))


def play(make_pipeline, frames):
    shared, pacer = two_threads.Shared(SIZE), gffe.Pacer(SHOWN, fps=RATE)
    renderer = Renderer(lambda: window.renderers_context())
    window = Window(shared, renderer, frames)
    two_threads.run(renderer, make_pipeline, window, shared, two_threads.Clock(), RATE, pacer)
    print(pacer.statistics)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--offscreen", action="store_true", help="measure, without a window")
    parser.add_argument("--frames", type=int, default=-1, help="stop after as many")
    given, device = parser.parse_args(), gffe.open_device()
    run = measure if given.offscreen else play
    run(lambda *size: gffe.Pipeline(device, *size, fps=RATE), given.frames)


if __name__ == "__main__":
    main()
