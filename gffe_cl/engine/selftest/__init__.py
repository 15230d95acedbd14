"""The self-test (`gffe selftest`): a fixed workload on every device, compared bit by bit with recorded references."""
