"""A renderer of one's own, in OpenGL: 15 rendered frames per second, shown as 60. See docs/tutorial_live.md.

python docs/examples/moderngl_live.py                           a window: no generated frames while Space is held
python docs/examples/moderngl_live.py --offscreen --frames 8    mean PSNR, dB, against really rendered frames
"""

import argparse
import math
import time

import glfw
import moderngl
import numpy as np

import gffe_cl as gffe

WIDTH, HEIGHT, RATE, SHOWN = 640, 360, 15, 60
VERTEX = """#version 330
uniform mat4 clip_from_world, old_clip_from_world, world_from_model, old_world_from_model;
in vec3 position, normal;
out vec3 place, world, up;
out vec4 clip, old_clip;
void main() {
    mat3 axes = mat3(world_from_model);
    place = position * vec3(length(axes[0]), length(axes[1]), length(axes[2]));  // the pattern moves with its box
    world = (world_from_model * vec4(position, 1)).xyz;
    up = axes * normal;
    clip = gl_Position = clip_from_world * vec4(world, 1);
    old_clip = old_clip_from_world * old_world_from_model * vec4(position, 1);
}"""
FRAGMENT = """#version 330
uniform vec3 lamp, tint;
uniform vec2 size;
in vec3 place, world, up;
in vec4 clip, old_clip;
layout(location = 0) out vec4 color;     // linear
layout(location = 1) out vec4 geometry;  // depth along the view, motion in pixels with y down
void main() {
    vec3 to_lamp = lamp - world, cell = floor(place * 2 + 1e-3);
    float light = 0.2 + 8 * max(dot(normalize(up), normalize(to_lamp)), 0) / (3 + dot(to_lamp, to_lamp));
    color = vec4(tint * light * (0.6 + 0.4 * mod(cell.x + cell.y + cell.z, 2)), 1);
    vec2 motion = (old_clip.xy / old_clip.w - clip.xy / clip.w) * 0.5 * size * vec2(1, -1);
    geometry = vec4(clip.w, motion, 1);
}"""
CORNERS = np.array([(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, -1, 1), (1, 1, 1), (-1, 1, 1)])
FACES = [[(1, 0, 0), (0, 1, 0)], [(0, 1, 0), (0, 0, 1)], [(0, 0, 1), (1, 0, 0)]]


def cube():
    """Return (36, 6) positions and normals of a cube from −1 to 1."""
    rows = []
    for sign in (1, -1):
        for u, v in FACES:
            axes = np.array([u, v, np.cross(u, v)]) * sign
            rows += [(*(corner @ axes), *axes[2]) for corner in CORNERS]
    return np.array(rows, np.float32)


def models(now):
    """Return (4, 4) model matrices and tints: a floor, and boxes that turn and travel."""
    yield np.diag([12, 0.1, 12, 1]), (0.5, 0.5, 0.45)
    for k in range(7):
        angle, matrix = now * (1 + 0.2 * k), np.eye(4)
        matrix[0, [0, 2]], matrix[2, [0, 2]] = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))
        matrix[:3, 3] = 4 * math.sin(k + 0.5 * now), 1.2, 1.9 * k - 7
        yield matrix @ np.diag([0.6, 1, 0.6, 1]), (0.3 + 0.1 * k, 0.9 - 0.1 * k, 0.4)


def camera_at(now):
    focal = 0.9 * WIDTH
    return gffe.Camera.look_at((9 * math.cos(0.4 * now), 4, 9 * math.sin(0.4 * now)), (0, 1, 0), (0, 1, 0),
                               focal, focal, WIDTH / 2, HEIGHT / 2)  # fmt: skip


class Renderer:
    def __init__(self, context):
        self.context = context
        self.program = context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self.cube = context.vertex_array(self.program, context.buffer(cube()), "position", "normal")
        planes = [context.texture((WIDTH, HEIGHT), 4, dtype="f4") for _ in range(2)]
        self.target = context.framebuffer(planes, context.depth_renderbuffer((WIDTH, HEIGHT)))

    def frame(self, now, before):
        """Return the frame of `now`; its motion leads to where all was at `before` (None: a reset)."""
        camera, old = camera_at(now), camera_at(now if before is None else before)
        clip, old_clip = (
            c.projection_matrix("opengl", WIDTH, HEIGHT, near=0.1, far=100) @ c.view_matrix("opengl")
            for c in (camera, old)
        )
        self.target.use()
        self.context.enable(moderngl.DEPTH_TEST)
        self.target.clear(0.1, 0.2, 0.4, 0)
        self.program["lamp"] = 3 * math.cos(2 * now), 3, 3 * math.sin(2 * now)
        self.program["size"] = WIDTH, HEIGHT
        for (model, tint), (old_model, _) in zip(models(now), models(now if before is None else before), strict=True):
            matrices = {"clip_from_world": clip, "old_clip_from_world": old_clip}
            for name, matrix in (matrices | {"world_from_model": model, "old_world_from_model": old_model}).items():
                self.program[name].write(matrix.T.astype("f4").tobytes())  # OpenGL keeps columns
            self.program["tint"] = tint
            self.cube.render()
        color, geometry = (
            np.frombuffer(self.target.read(components=4, attachment=k, dtype="f4"), "f4").reshape(HEIGHT, WIDTH, 4)[
                ::-1
            ]
            for k in range(2)
        )
        depth, motion = np.where(geometry[..., 3] > 0, geometry[..., 0], np.inf), geometry[..., 1:3].copy()
        rows, columns = np.nonzero(np.isinf(depth))  # the sky turns with the camera: take it for very far
        there = camera.unproject(np.stack([columns + 0.5, rows + 0.5], -1), np.full(len(rows), 1e6))
        motion[rows, columns] = old.project(there)[0] - np.stack([columns + 0.5, rows + 0.5], -1)
        return gffe.RenderedFrame(color[..., :3], depth, motion, camera, now, reset=before is None)


def measure(renderer, pipeline, frames):
    """Print mean PSNR of frames halfway between rendered ones: repeated, and generated."""
    found = []
    for k in range(frames):
        frame = renderer.frame(k / RATE, (k - 1) / RATE if k else None)
        pipeline.submit(frame)
        truth = renderer.frame((k + 0.5) / RATE, None)
        made = pipeline.extrapolate(truth.camera, truth.time).numpy("color")
        images = [gffe.to_display(image) for image in (frame.color, made, truth.color)]
        found.append([gffe.psnr(image, images[2]) for image in images[:2]])
    print("repeat {:.2f} gffe {:.2f}".format(*np.mean(found[2:], axis=0)))


def play(window, context, renderer, pipeline, frames):
    shader = """#version 330
    {} vec2 uv; void main() {{ {} }}"""
    blit = context.program(
        vertex_shader=shader.format("in vec2 p; out", "uv = p * vec2(0.5, -0.5) + 0.5; gl_Position = vec4(p, 0, 1);"),
        fragment_shader=shader.format("uniform sampler2D image; out vec4 c; in", "c = texture(image, uv);"),
    )
    screen = context.vertex_array(blit, context.buffer(np.array([-1, -1, 3, -1, -1, 3], "f4")), "p")
    texture, pacer, before = context.texture((WIDTH, HEIGHT), 3, alignment=1), gffe.Pacer(SHOWN), None
    begin = time.perf_counter()
    while not glfw.window_should_close(window) and frames:
        frames -= 1
        now = time.perf_counter() - begin
        if before is None or now - before >= 1 / RATE:
            pipeline.submit(renderer.frame(now, before))
            pacer.rendered(before := now)
        plan = pacer.plan(time.perf_counter() - begin)
        if not plan.held:
            generate = not glfw.get_key(window, glfw.KEY_SPACE)
            camera = camera_at(time.perf_counter() - begin)  # the newest one
            made = pipeline.extrapolate(camera, plan.time) if generate else pipeline.present()
            texture.write((255 * gffe.to_display(made.numpy("color")) + 0.5).astype("u1").tobytes())
        pacer.ready(time.perf_counter() - begin)
        time.sleep(max(plan.refresh - (time.perf_counter() - begin), 0))
        context.screen.use()
        context.viewport = 0, 0, *glfw.get_framebuffer_size(window)
        context.disable(moderngl.DEPTH_TEST)
        texture.use()
        screen.render()
        glfw.swap_buffers(window)
        glfw.poll_events()
    print(pacer.statistics)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--offscreen", action="store_true", help="measure, without a window")
    parser.add_argument("--frames", type=int, default=-1, help="stop after as many")
    given = parser.parse_args()
    pipeline = gffe.Pipeline(gffe.open_device(), WIDTH, HEIGHT)
    if given.offscreen:
        context = moderngl.create_context(standalone=True, require=330, backend="egl")
        return measure(Renderer(context), pipeline, max(given.frames, 3))
    glfw.init()
    for hint in (glfw.CONTEXT_VERSION_MAJOR, glfw.CONTEXT_VERSION_MINOR):
        glfw.window_hint(hint, 3)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    window = glfw.create_window(WIDTH, HEIGHT, "gffe-cl", None, None)
    glfw.make_context_current(window)
    context = moderngl.create_context()
    play(window, context, Renderer(context), pipeline, given.frames)


if __name__ == "__main__":
    main()
