"""Devices as they are described once they were probed."""

from gffe_cl.engine.opencl.device import DeviceInfo


def info(index, name, platform, kind="cpu", version="", works=True, speed=1.0):
    return DeviceInfo(index, name, platform, version, "1", kind, works, megapixels_per_second=speed)


POCL = info("0:0", "pthread-Intel(R) Xeon(R)", "Portable Computing Language", version="OpenCL 3.0 PoCL 3.1")
INTEL = info("1:0", "Intel(R) Xeon(R)", "Intel(R) OpenCL", speed=4)
GPU = info("2:0", "Some GPU", "Vendor", "gpu", speed=60)
OLD_GPU = info("3:0", "Old GPU", "Vendor", "gpu", speed=2)
