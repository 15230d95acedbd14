"""A small ONNX network of the contract of `gffe eval --onnx`."""

import onnx
from onnx import TensorProto, helper


def network(path, frames=2, following=True, timestep=True, name="frame"):
    """Return (1 − α) · newest of `previous` + α · `next`; without those, the oldest of `previous`."""
    shape = (1, 3 * frames, "h", "w")
    inputs = [helper.make_tensor_value_info("previous", TensorProto.FLOAT, shape)]
    start, end = (3 * frames - 3, 3 * frames) if following else (0, 3)
    nodes = [helper.make_node("Slice", ["previous", "start", "end", "axis"], ["taken"])]
    last = "taken"
    if following:
        inputs.append(helper.make_tensor_value_info("next", TensorProto.FLOAT, (1, 3, "h", "w")))
        inputs.append(helper.make_tensor_value_info("timestep", TensorProto.FLOAT, (1, 1, 1, 1)))
        nodes += [
            helper.make_node("Sub", ["next", "taken"], ["change"]),
            helper.make_node("Mul", ["change", "timestep"], ["part"]),
            helper.make_node("Add", ["taken", "part"], ["mixed"]),
        ]
        last = "mixed"
    nodes.append(helper.make_node("Identity", [last], [name]))
    constants = [
        helper.make_tensor(n, TensorProto.INT64, [1], [v]) for n, v in (("start", start), ("end", end), ("axis", 1))
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 3, "h", "w"))]
    graph = helper.make_graph(nodes, "small", inputs, outputs, constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return path
