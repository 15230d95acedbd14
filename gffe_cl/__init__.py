"""gffe-cl: G-buffer free frame extrapolation (GFFE) in portable OpenCL.

import gffe_cl as gffe

pipeline = gffe.Pipeline(gffe.open_device(), width, height)
pipeline.submit(gffe.RenderedFrame(color, depth, motion, camera, time))
frame = pipeline.extrapolate(next_camera, next_time)
frame.color                 # device buffer
frame.numpy("color")        # NumPy array
"""

from gffe_cl.engine.core.public_names import __all__, __dir__, __getattr__, __version__  # noqa: F401
