# Records what the current camera of a Godot 3 game sees, as a folder that gffe-cl opens: see docs/formats.md.
# Project settings, AutoLoad: add this file. Run the game with GLES3:
#     godot3 --path GAME --video-driver GLES3 --fixed-fps 30
extends Node

export var folder = "user://capture"
export var size = Vector2(640, 360)  # pixels
export var frames = 16
export var fps = 30

const GEOMETRY = """shader_type spatial;
render_mode unshaded;
uniform mat4 old_world;
uniform mat4 old_view;
varying vec4 clip;
varying vec4 old_clip;
void vertex() {
	clip = PROJECTION_MATRIX * MODELVIEW_MATRIX * vec4(VERTEX, 1.0);
	old_clip = PROJECTION_MATRIX * old_view * old_world * vec4(VERTEX, 1.0);
}
void fragment() {
	vec2 motion = 0.5 * (old_clip.xy / old_clip.w - clip.xy / clip.w);  // of the image's sides, y up
	ALBEDO = vec3(motion * VIEWPORT_SIZE * vec2(1.0, -1.0), clip.w);
}"""

var view = Viewport.new()
var shader = Shader.new()
var old_view = null  # world to camera, of the frame before
var old_worlds = {}  # of each mesh
var cameras = []


func _ready():
	Directory.new().make_dir_recursive(folder)
	shader.code = GEOMETRY
	view.size = size
	view.world = get_viewport().world  # the game's own
	view.keep_3d_linear = true
	view.render_target_v_flip = true
	view.render_target_update_mode = Viewport.UPDATE_ALWAYS
	add_child(view)
	get_tree().connect("idle_frame", self, "record")  # all nodes are where they are drawn


func record():
	var camera = get_viewport().get_camera()
	if camera == null:
		return
	VisualServer.viewport_attach_camera(view.get_viewport_rid(), camera.get_camera_rid())
	var k = cameras.size()
	write_pixels("color_%d.npy" % k)

	var world_to_view = camera.get_camera_transform().affine_inverse()
	var materials = {}
	var worlds = {}
	for mesh in meshes(get_tree().root):
		worlds[mesh] = mesh.global_transform
		materials[mesh] = mesh.material_override
		var geometry = ShaderMaterial.new()
		geometry.shader = shader
		geometry.set_shader_param("old_world", old_worlds.get(mesh, worlds[mesh]))
		geometry.set_shader_param("old_view", old_view if old_view != null else world_to_view)
		mesh.material_override = geometry
	var environment = view.world.environment
	view.world.environment = null  # no sky and no tone mapping
	VisualServer.set_default_clear_color(Color(0, 0, 0))
	write_pixels("geometry_%d.npy" % k)
	VisualServer.set_default_clear_color(ProjectSettings.get_setting("rendering/environment/default_clear_color"))
	view.world.environment = environment
	for mesh in materials:
		mesh.material_override = materials[mesh]

	var t = camera.get_camera_transform()
	var rows = []
	for row in range(3):
		rows.append([t.basis.x[row], t.basis.y[row], t.basis.z[row], t.origin[row]])
	cameras.append({"view": rows + [[0, 0, 0, 1]], "fov_y": camera.fov})
	old_view = world_to_view
	old_worlds = worlds
	if cameras.size() == frames:
		write_description()
		get_tree().quit()


func meshes(node):
	var found = [node] if node is MeshInstance and node.is_visible_in_tree() else []
	for child in node.get_children():
		found += meshes(child)
	return found


func write_pixels(name):
	VisualServer.force_draw(false)
	var image = view.get_texture().get_data()  # half floats, RGBA
	var header = "{'descr': '<f2', 'fortran_order': False, 'shape': (%d, %d, 4)}" % [size.y, size.x]
	header = "%-117s\n" % header  # with what precedes it 128 bytes
	var file = File.new()
	file.open(folder + "/" + name, File.WRITE)
	file.store_buffer(PoolByteArray([0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0]))  # NumPy's format, 1.0
	file.store_16(header.length())
	file.store_string(header)
	file.store_buffer(image.get_data())
	file.close()


func write_description():
	var file = File.new()
	file.open(folder + "/sequence.json", File.WRITE)
	file.store_string(JSON.print({
		"format": "gffe-folder", "version": 2, "width": size.x, "height": size.y, "fps": fps,
		"frames": {"count": frames},
		"files": {
			"color": "color_%d.npy",
			"motion": {"file": "geometry_%d.npy", "channels": ["0", "1"]},
			"depth": {"file": "geometry_%d.npy", "channels": ["2"], "sky": 0},
		},
		"cameras": {"convention": "opengl", "matrix": "view_to_world", "list": cameras},
	}, " "))
	file.close()
