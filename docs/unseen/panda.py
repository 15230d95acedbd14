"""Panda3D, offscreen: a lit color pass, and a pass of depth and motion vectors without multisampling."""

from __future__ import annotations

import numpy as np
from direct.showbase.ShowBase import ShowBase
from panda3d.core import (
    BitMask32,
    Camera,
    DirectionalLight,
    FrameBufferProperties,
    Geom,
    GeomEnums,
    GeomNode,
    GeomTriangles,
    GeomVertexArrayFormat,
    GeomVertexData,
    GeomVertexFormat,
    GraphicsOutput,
    GraphicsPipe,
    InternalName,
    LMatrix4f,
    LVecBase4f,
    NodePath,
    PerspectiveLens,
    SamplerState,
    Shader,
    Texture,
    TransparencyAttrib,
    WindowProperties,
    loadPrcFileData,
)

import gffe_cl as gffe
from unseen.recording import Picture, linear_from_bytes, opengl_view, with_sky

loadPrcFileData(
    "", "load-display p3headlessgl\naudio-library-name null\nnotify-level error\nnotify-level-device fatal\n"
)

NEAR, FAR = 0.1, 4000.0
_COLOR_ONLY = BitMask32.bit(3)

_VERTEX = """#version 330
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelViewMatrix, previous_from_view;
uniform mat3 p3d_NormalMatrix;
in vec4 p3d_Vertex;
in vec3 p3d_Normal, shift;  // shift: where a deformed vertex was before, in model space
in vec2 p3d_MultiTexCoord0;
out vec3 here, before, normal;
out vec2 uv;
void main() {
    here = (p3d_ModelViewMatrix * p3d_Vertex).xyz;
    before = (previous_from_view * p3d_ModelViewMatrix * (p3d_Vertex + vec4(shift, 0))).xyz;
    normal = p3d_NormalMatrix * p3d_Normal;
    uv = p3d_MultiTexCoord0;
    gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;
}
"""
_LIT = """#version 330
uniform sampler2D p3d_Texture0;
uniform struct p3d_LightSourceParameters {
    vec4 color, position;
    mat4 shadowViewMatrix;
    sampler2DShadow shadowMap;
} p3d_LightSource[1];
uniform vec4 ambient, fog;  // fog: color, and distance at which it takes 63%
in vec3 here, normal;
in vec2 uv;
out vec4 color;
void main() {
    vec4 texel = texture(p3d_Texture0, uv);
    if (texel.a < 0.5) discard;
    vec3 to_sun = normalize(p3d_LightSource[0].position.xyz);
    vec3 up = normalize(gl_FrontFacing ? normal : -normal);
    float facing = max(dot(up, to_sun), 0);
    vec4 place = p3d_LightSource[0].shadowViewMatrix * vec4(here + 0.08 * up, 1);
    float lit = facing * textureProj(p3d_LightSource[0].shadowMap, place);
    vec3 halfway = normalize(to_sun - normalize(here));
    float shine = 0.25 * pow(max(dot(up, halfway), 0), 32) * lit;
    vec3 shaded = texel.rgb * (ambient.rgb + p3d_LightSource[0].color.rgb * lit) + shine;
    color = vec4(mix(fog.rgb, shaded, exp(here.z / fog.a)), 1);
}
"""
_GEOMETRY = """#version 330
uniform sampler2D p3d_Texture0;
uniform vec4 pinhole;
in vec3 here, before;
in vec2 uv;
out vec4 depth_and_motion;
vec2 projected(vec3 p) { return pinhole.zw + pinhole.xy * vec2(p.x, -p.y) / -p.z; }
void main() {
    if (texture(p3d_Texture0, uv).a < 0.5) discard;
    depth_and_motion = vec4(-here.z, projected(before) - projected(here), 1);
}
"""
_SKY_VERTEX = """#version 330
uniform mat4 p3d_ModelViewMatrix, p3d_ProjectionMatrix;
uniform mat4 p3d_ModelMatrix;
in vec4 p3d_Vertex;
out vec3 direction;
void main() {
    direction = p3d_Vertex.xyz;
    gl_Position = (p3d_ProjectionMatrix * vec4(mat3(p3d_ModelViewMatrix) * p3d_Vertex.xyz, 1)).xyww;
}
"""
_SKY = """#version 330
uniform sampler2D clouds;
uniform vec4 fog, zenith;
in vec3 direction;
out vec4 color;
void main() {
    vec3 d = normalize(direction);
    float up = max(d.z, 0);
    float cover = smoothstep(0.45, 0.75, texture(clouds, d.xy / (d.z + 0.25) * 0.2).r) * smoothstep(0.02, 0.2, d.z);
    vec3 blue = mix(fog.rgb, zenith.rgb, pow(up, 0.6));
    color = vec4(mix(blue, vec3(0.97, 0.96, 0.94), cover), 1);
}
"""


class PandaRenderer:
    """A Panda3D scene below `root`, rendered from gffe cameras.

    Parameters
    ----------
    width, height : int
        Of the image, pixels.
    samples : int
        Of the color pass, for each pixel; 0 or 1: one.
    shadow_size : float
        Side of the square that the sun's shadow map covers, world units.
    """

    def __init__(self, width: int, height: int, samples: int, shadow_size: float):
        self.width, self.height = width, height
        self._base = ShowBase(windowType="offscreen")
        self.loader, self.root = self._base.loader, NodePath("scene")
        self.root.setTransparency(TransparencyAttrib.M_binary, 1)
        self._has_shadows = False
        self._movers: dict[NodePath, tuple[np.ndarray, np.ndarray]] = {}
        self._lens = PerspectiveLens()
        self._lens.setFilmSize(width, height)
        self._lens.setNearFar(NEAR, FAR)
        color = FrameBufferProperties()
        color.setRgbaBits(8, 8, 8, 8)
        color.setDepthBits(24)
        color.setMultisamples(samples if samples > 1 else 0)
        geometry = FrameBufferProperties()
        geometry.setFloatColor(True)
        geometry.setRgbaBits(32, 32, 32, 32)
        geometry.setDepthBits(24)
        self._color = self._pass("color", color, Shader.make(Shader.SL_GLSL, _VERTEX, _LIT))
        self._geometry = self._pass("geometry", geometry, Shader.make(Shader.SL_GLSL, _VERTEX, _GEOMETRY))
        self._geometry[1].node().setCameraMask(BitMask32.bit(0))
        self._color[1].node().setCameraMask(BitMask32.bit(0) | _COLOR_ONLY)
        self.sun = self.root.attachNewNode(DirectionalLight("sun"))
        light = self.sun.node()
        light.setShadowCaster(True, 2048, 2048)
        light.getLens().setFilmSize(shadow_size, shadow_size)
        light.getLens().setNearFar(1, 4 * shadow_size)
        light.setCameraMask(BitMask32.bit(0))
        self._shadow_distance = 2 * shadow_size
        self.root.setLight(self.sun)

    def set_light(self, toward_sun, center, color, ambient, fog, zenith) -> None:
        """Let the sun shine from a direction, with its shadow map around `center`; colors are display values."""
        direction = np.asarray(toward_sun, float) / np.linalg.norm(toward_sun)
        self.sun.setPos(*(np.asarray(center) + self._shadow_distance * direction))
        self.sun.lookAt(*center)
        self.sun.node().setColor((*color, 1))
        self.root.setShaderInput("ambient", LVecBase4f(*ambient, 1))
        self.root.setShaderInput("fog", LVecBase4f(*fog))
        self.root.setShaderInput("zenith", LVecBase4f(*zenith, 1))

    def add_sky(self, clouds: np.ndarray) -> None:
        """Draw a sky with these clouds, (H, W) within 0 … 1, behind everything."""
        sky = self.root.attachNewNode(mesh_node(*box((-1, -1, -1), (1, 1, 1))))
        sky.setShader(Shader.make(Shader.SL_GLSL, _SKY_VERTEX, _SKY), 10)
        sky.setShaderInput("clouds", texture(np.repeat(clouds[..., None], 3, -1)))
        sky.setTwoSided(True)
        sky.setDepthWrite(False)
        sky.setDepthTest(False)
        sky.setBin("background", 0)
        sky.node().setBounds(_everywhere())
        sky.node().setFinal(True)
        sky.hide(BitMask32.bit(0))
        sky.showThrough(_COLOR_ONLY)

    def place(self, node: NodePath, now: np.ndarray, before: np.ndarray) -> None:
        """Put a mover directly below `root` at the model matrix `now`; it was at `before`."""
        node.setMat(_panda_matrix(now))
        self._movers[node] = now, before

    def forget(self, node: NodePath) -> None:
        """Remove a mover."""
        del self._movers[node]
        node.removeNode()

    def picture(self, camera: gffe.Camera, previous: gffe.Camera | None) -> Picture:
        """Return what is seen at `time` (seconds), with motion since `previous`."""
        view, old_view = opengl_view(camera), opengl_view(previous or camera)
        axes = np.eye(4)  # Panda's camera looks along y, with z up
        axes[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
        for node in (self._color[1], self._geometry[1]):
            node.setMat(_panda_matrix(np.linalg.inv(view) @ axes))
        self._lens.setFocalLength(camera.fx)
        self.root.setShaderInput("pinhole", LVecBase4f(*camera.intrinsics))
        self._set_previous(self.root, old_view @ np.linalg.inv(view))
        for node, (now, before) in self._movers.items():
            self._set_previous(node, old_view @ before @ np.linalg.inv(now) @ np.linalg.inv(view))
        for _ in range(1 if self._has_shadows else 2):  # the first picture makes the shadow map
            self._base.graphicsEngine.renderFrame()
        self._has_shadows = True
        color = self._read(self._color[0], np.uint8)[..., :3]
        found = self._read(self._geometry[0], np.float32)
        depth, motion = with_sky(found[..., 0], found[..., 1:3], camera, previous)
        return Picture(linear_from_bytes(color), depth, motion, camera)

    def close(self) -> None:
        """Release the engine, of which a process has one at a time."""
        self._base.destroy()

    def _pass(self, name: str, properties: FrameBufferProperties, shader: Shader) -> tuple[Texture, NodePath]:
        base = self._base
        buffer = base.graphicsEngine.makeOutput(
            base.pipe, name, 0, properties, WindowProperties.size(self.width, self.height),
            GraphicsPipe.BF_refuse_window, base.win.getGsg(), base.win,
        )  # fmt: skip
        found = Texture(name)
        buffer.addRenderTexture(found, GraphicsOutput.RTM_copy_ram, GraphicsOutput.RTP_color)
        buffer.setClearColor((0, 0, 0, 0))
        node = self.root.attachNewNode(Camera(name, self._lens))
        state = NodePath("state")
        state.setShader(shader)
        node.node().setInitialState(state.getState())
        buffer.makeDisplayRegion().setCamera(node)
        return found, node

    def _read(self, found: Texture, dtype) -> np.ndarray:
        values = np.frombuffer(found.getRamImage(), dtype).reshape(self.height, self.width, 4)
        return values[::-1, :, [2, 1, 0, 3]]

    def _set_previous(self, node: NodePath, matrix: np.ndarray) -> None:
        node.setShaderInput("previous_from_view", _panda_matrix(matrix))


def texture(values: np.ndarray, mipmaps: bool = False) -> Texture:
    """Return a repeating texture of (H, W, 3) display values within 0 … 1."""
    height, width, _ = values.shape
    made = Texture()
    made.setup2dTexture(width, height, Texture.T_unsigned_byte, Texture.F_rgb)
    made.setRamImageAs(np.ascontiguousarray(np.round(255 * np.clip(values[::-1], 0, 1)).astype(np.uint8)), "RGB")
    made.setWrapU(SamplerState.WM_repeat)
    made.setWrapV(SamplerState.WM_repeat)
    if mipmaps:
        made.setMinfilter(SamplerState.FT_linear_mipmap_linear)
        made.setAnisotropicDegree(8)
    return made


def mesh_node(vertices: np.ndarray, triangles: np.ndarray, shift: np.ndarray | None = None) -> GeomNode:
    """Return a node of triangles (N, 3). Vertices (M, 8): position, normal, texture coordinates; `shift` (M, 3): to
    where each of them was before."""
    columns = [
        ("vertex", 3, GeomEnums.C_point),
        ("normal", 3, GeomEnums.C_normal),
        ("texcoord", 2, GeomEnums.C_texcoord),
    ]
    if shift is not None:
        columns.append(("shift", 3, GeomEnums.C_other))
        vertices = np.hstack([vertices, shift])
    layout, form = GeomVertexArrayFormat(), GeomVertexFormat()
    for name, count, kind in columns:
        layout.addColumn(InternalName.make(name), count, GeomEnums.NT_float32, kind)
    form.addArray(layout)
    data = GeomVertexData("mesh", GeomVertexFormat.registerFormat(form), Geom.UHStatic)
    data.uncleanSetNumRows(len(vertices))
    data.modifyArrayHandle(0).setData(np.ascontiguousarray(vertices, np.float32).tobytes())
    indices = GeomTriangles(Geom.UHStatic)
    indices.setIndexType(GeomEnums.NT_uint32)
    numbers = np.ascontiguousarray(triangles, np.uint32)
    indices.modifyVertices().uncleanSetNumRows(numbers.size)
    indices.modifyVertices().modifyHandle().setData(numbers.tobytes())
    geom = Geom(data)
    geom.addPrimitive(indices)
    node = GeomNode("mesh")
    node.addGeom(geom)
    return node


def box(low, high, texels: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of a box between two corners; a texture repeats `texels` times per unit."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    vertices, triangles = [], []
    for axis in range(3):
        u, v = ((1, 2), (0, 2), (0, 1))[axis]
        for side, outward in ((low, -1.0), (high, 1.0)):
            corners = []
            for pu, pv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                place, normal = side.copy(), np.zeros(3)
                place[u], place[v] = (low, high)[pu][u], (low, high)[pv][v]
                normal[axis] = outward
                corners.append((*place, *normal, place[u] * texels, place[v] * texels))
            first = len(vertices)
            vertices += corners
            faces = [(0, 1, 2), (0, 2, 3)]
            flipped = (outward > 0) == (axis == 1)
            triangles += [tuple(first + k for k in (face[::-1] if flipped else face)) for face in faces]
    return np.array(vertices), np.array(triangles)


def joined(parts) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return np.vstack([v for v, _ in parts]), np.vstack([t + n for (_, t), n in zip(parts, first, strict=False)])


def _panda_matrix(matrix: np.ndarray) -> LMatrix4f:
    """Return a matrix of column vectors as Panda3D, which has row vectors, wants it."""
    return LMatrix4f(*np.asarray(matrix).T.ravel())


def _everywhere():
    from panda3d.core import OmniBoundingVolume

    return OmniBoundingVolume()
