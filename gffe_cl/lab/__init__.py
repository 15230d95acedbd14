"""Lab: the part that research needs. Metrics, comparisons, benchmarks, the table of methods, training."""
