"""The part that research needs: metrics, comparisons, benchmarks, the table of methods, training."""
