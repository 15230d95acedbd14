# A room with a turning box, a bouncing ball and a camera that walks, recorded by capture.gd:
#     xvfb-run -a godot3 --path docs/godot3 --video-driver GLES3 --audio-driver Dummy --fixed-fps 30 \
#         -s example.gd FOLDER
extends SceneTree


class Room extends Spatial:
	var time = 0.0
	var box
	var ball
	var camera = Camera.new()

	func _ready():
		add_mesh(CubeMesh.new(), Vector3(0, -0.1, -6), Vector3(20, 0.1, 8), Color(0.9, 0.8, 0.7))
		add_mesh(CubeMesh.new(), Vector3(0, 3, -12), Vector3(20, 4, 0.1), Color(0.5, 0.7, 0.9))
		add_mesh(CubeMesh.new(), Vector3(-2, 1, -8), Vector3(0.4, 1, 0.4), Color(0.5, 0.9, 0.4))
		box = add_mesh(CubeMesh.new(), Vector3(1, 0.8, -5), Vector3(0.7, 0.7, 0.7), Color(0.9, 0.3, 0.2))
		ball = add_mesh(SphereMesh.new(), Vector3(-1, 1, -4), Vector3(0.5, 0.5, 0.5), Color(0.9, 0.8, 0.3))
		var light = DirectionalLight.new()
		light.rotation_degrees = Vector3(-50, 30, 0)
		light.light_energy = 3
		add_child(light)
		add_child(camera)
		_process(0)

	func add_mesh(mesh, place, size, color):
		var noise = OpenSimplexNoise.new()
		noise.period = 20
		var texture = ImageTexture.new()
		texture.create_from_image(noise.get_seamless_image(256))
		var instance = MeshInstance.new()
		instance.mesh = mesh
		instance.material_override = SpatialMaterial.new()
		instance.material_override.albedo_color = color
		instance.material_override.albedo_texture = texture
		instance.translation = place
		instance.scale = size
		add_child(instance)
		return instance

	func _process(delta):
		time += delta
		box.rotation = Vector3(0, 1.5 * time, 0)
		ball.translation = Vector3(-1 + 1.2 * time, 0.5 + abs(sin(3 * time)), -4)
		camera.translation = Vector3(1.5 * time, 1.6, 0)
		camera.rotation = Vector3(-0.1, -0.4 * time, 0)


func _init():
	var capture = preload("capture.gd").new()
	capture.folder = OS.get_cmdline_args()[-1]
	capture.size = Vector2(320, 180)
	capture.frames = 10
	root.call_deferred("add_child", Room.new())
	root.call_deferred("add_child", capture)
