"""Benchmarks of `gffe bench` beyond the times of stages."""
