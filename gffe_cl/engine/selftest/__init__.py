"""The self-test (`gffe selftest`): a fixed workload on every device, compared bit by bit with recorded references."""

from gffe_cl.engine.selftest.report import DeviceResult, NetworkResult, SelfTest, selftest

__all__ = ["DeviceResult", "NetworkResult", "SelfTest", "selftest"]
