"""What research needs: metrics, comparisons, benchmarks, the table of methods, training."""
