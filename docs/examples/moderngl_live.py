"""A renderer of one's own, in OpenGL: 15 rendered frames per second, shown as 60. See docs/tutorial_live.md.

python docs/examples/moderngl_live.py                           a window: no generated frames while Space is held
python docs/examples/moderngl_live.py --offscreen --frames 8    mean PSNR, dB, against really rendered frames
"""

import argparse
import time
from pathlib import Path

import glfw
import moderngl
import numpy as np

import gffe_cl as gffe

WIDTH, HEIGHT, RATE, SHOWN = 640, 360, 15, 60
VERTEX, FRAGMENT = (Path(__file__).with_suffix(end).read_text() for end in (".vert", ".frag"))


def models(now):
    """Yield (4, 4) model matrices and tints: a floor, and boxes that turn and travel."""
    yield np.diag([12, 0.1, 12, 1]), (0.5, 0.5, 0.45)
    for k in range(7):
        angle, matrix = now * (1 + 0.2 * k), np.eye(4)
        matrix[0, [0, 2]], matrix[2, [0, 2]] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
        matrix[:3, 3] = 4 * np.sin(k + 0.5 * now), 1.2, 1.9 * k - 7
        yield matrix @ np.diag([0.6, 1, 0.6, 1]), (0.3 + 0.1 * k, 0.9 - 0.1 * k, 0.4)


def camera_at(now):
    pinhole = 576, 576, WIDTH / 2, HEIGHT / 2
    return gffe.Camera.look_at((9 * np.cos(0.4 * now), 4, 9 * np.sin(0.4 * now)), (0, 1, 0), (0, 1, 0), *pinhole)


def clip_from_world(camera):
    return camera.projection_matrix("opengl", WIDTH, HEIGHT, near=0.1, far=100) @ camera.view_matrix("opengl")


class Renderer:
    def __init__(self, context):
        self.program = context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self.cube = context.vertex_array(self.program, [])
        planes = [context.texture((WIDTH, HEIGHT), 4, dtype="f4") for _ in range(2)]
        self.target = context.framebuffer(planes, context.depth_renderbuffer((WIDTH, HEIGHT)))
        context.enable(moderngl.DEPTH_TEST)

    def frame(self, now, before):
        """Return the frame of `now`; its motion leads to where all was at `before` (None: a reset)."""
        then, camera = now if before is None else before, camera_at(now)
        self.target.use()
        self.target.clear(0.1, 0.2, 0.4, 0)
        self.program["lamp"] = 3 * np.cos(2 * now), 3, 3 * np.sin(2 * now)
        self.program["size"] = WIDTH, HEIGHT
        matrices = {"clip_from_world": clip_from_world(camera), "old_clip_from_world": clip_from_world(camera_at(then))}
        for (model, tint), (old_model, _) in zip(models(now), models(then), strict=True):
            matrices |= {"world_from_model": model, "old_world_from_model": old_model}
            for name, matrix in matrices.items():
                self.program[name].write(matrix.T.astype("f4").tobytes())  # OpenGL keeps columns
            self.program["tint"] = tint
            self.cube.render(moderngl.TRIANGLE_STRIP, vertices=14)
        planes = [self.target.read(components=4, attachment=k, dtype="f4") for k in range(2)]
        color, geometry = (np.frombuffer(plane, "f4").reshape(HEIGHT, WIDTH, 4)[::-1] for plane in planes)
        depth = np.where(geometry[..., 3] > 0, geometry[..., 0], np.inf)  # nothing was drawn: the sky
        return gffe.RenderedFrame(color[..., :3], depth, geometry[..., 1:3], camera, now, reset=before is None)


def measure(pipeline, frames):
    """Print mean PSNR of frames halfway between rendered ones: repeated, and generated."""
    renderer = Renderer(moderngl.create_context(standalone=True, require=330, backend="egl"))
    found = []
    for k in range(max(frames, 3)):
        frame = renderer.frame(k / RATE, (k - 1) / RATE if k else None)
        pipeline.submit(frame)
        truth = renderer.frame((k + 0.5) / RATE, None)
        made = pipeline.extrapolate(truth.camera, truth.time).numpy("color")
        images = [gffe.to_display(image) for image in (frame.color, made, truth.color)]
        found.append([gffe.psnr(image, images[2]) for image in images[:2]])
    print("repeat {:.2f} gffe {:.2f}".format(*np.mean(found[2:], axis=0)))


def play(pipeline, frames):
    glfw.init()
    glfw.window_hint(glfw.RESIZABLE, False)
    window = glfw.create_window(WIDTH, HEIGHT, "gffe-cl", None, None)
    glfw.make_context_current(window)
    context = moderngl.create_context(require=330)
    renderer, texture = Renderer(context), context.texture((WIDTH, HEIGHT), 3, alignment=1)
    picture, pacer, before = context.framebuffer([texture]), gffe.Pacer(SHOWN), None
    while not glfw.window_should_close(window) and frames:
        frames -= 1
        now = glfw.get_time()
        if before is None or now - before >= 1 / RATE:
            pipeline.submit(renderer.frame(now, before))
            pacer.rendered(before := now)
        plan = pacer.plan(glfw.get_time())
        if not plan.held:
            generate = not glfw.get_key(window, glfw.KEY_SPACE)
            made = pipeline.extrapolate(camera_at(glfw.get_time()), plan.time) if generate else pipeline.present()
            texture.write((255 * gffe.to_display(made.numpy("color"))[::-1] + 0.5).astype("u1").tobytes())
        pacer.ready(glfw.get_time())
        time.sleep(max(plan.refresh - glfw.get_time(), 0))
        context.copy_framebuffer(context.screen, picture)
        glfw.swap_buffers(window)
        glfw.poll_events()
    print(pacer.statistics)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--offscreen", action="store_true", help="measure, without a window")
    parser.add_argument("--frames", type=int, default=-1, help="stop after as many")
    given = parser.parse_args()
    run = measure if given.offscreen else play
    run(gffe.Pipeline(gffe.open_device(), WIDTH, HEIGHT), given.frames)


if __name__ == "__main__":
    main()
