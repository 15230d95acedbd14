"""The pipeline as C for engines (`gffe export`)."""
