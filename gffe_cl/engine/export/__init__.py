"""The pipeline as C for engines (`gffe export`)."""

from gffe_cl.engine.export.writing import export

__all__ = ["export"]
