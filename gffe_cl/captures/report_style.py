"""Style of HTML reports: the CSS that all of them share."""

from importlib.resources import files


def report_style() -> str:
    """Return the CSS for light and dark, narrow and wide pages, and for print."""
    return files("gffe_cl.captures").joinpath("report.css").read_text("utf-8")
