"""Sphinx: the site that `make docs` builds from the pages in this folder into out/docs."""

from __future__ import annotations

import html
import re
import subprocess
import sys

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import gffe_cl

project = "gffe-cl"
author = "The authors of gffe-cl"
version = release = gffe_cl.__version__
html_title = f"gffe-cl {version}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_copybutton"]
exclude_patterns = ["examples", "tools", "measured", "blender"]
html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_copyright = False
highlight_language = "none"

myst_enable_extensions = ["substitution"]
myst_substitutions = {"version": version}
myst_heading_anchors = 4  # the same as GitHub's: links are valid in the repository and on the site

autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
napoleon_google_docstring = False
napoleon_use_param = False  # types are descriptions, such as "(H, W) float32": there is nothing to link
napoleon_use_rtype = False
napoleon_use_ivar = True
default_role = "py:obj"

# Types of other projects, and names in backticks that are parameters, commands or values.
nitpick_ignore_regex = [(r"py:.*", r"(?!gffe_cl\.).*")]
# Types of the package that are only handed on.
nitpick_ignore = [
    ("py:class", f"gffe_cl.{name}")
    for name in (
        "engine.opencl.device.Opened",
        "engine.opencl.sharing.SharedSemaphore",
        "captures.sequence.description.Description",
        "captures.sequence.exr.Pixels",
        "engine.stages.buffers.BufferSpec",
        "engine.stages.buffers.Owner",
    )
]

# Links into the repository to Markdown that is a page of the site, too.
_PAGES_ELSEWHERE = {
    "../README.md#limits": "limits.md",
    "../README.md#help": "help.md",
    "../gffe_cl/engine/inference/weights/MODEL_CARD.md": "model_card.md",
    "../gffe_cl/engine/export/c/README.md": "c_interface.md",
    "../CONTRIBUTING.md": "contributing.md",
}
_COMMAND_LINE = (sys.executable, "-m", "typer", "gffe_cl.cli.commands", "utils", "docs", "--name", "gffe")


def _link_pages_elsewhere(app: Sphinx, page: str, source: list[str]) -> None:
    for there, here in _PAGES_ELSEWHERE.items():
        for end in ")#":
            source[0] = source[0].replace(f"]({there}{end}", f"]({here}{end}")


def _link_names(app: Sphinx, page: str, source: list[str]) -> None:
    """Link the names in the table of the Python interface to their descriptions."""
    if page == "api":
        source[0] = re.sub(r"^\| `(\w+)`", r"| {py:obj}`\1 <gffe_cl.\1>`", source[0], flags=re.MULTILINE)


def _append_commands(app: Sphinx, page: str, source: list[str]) -> None:
    """Put the reference of the command line on its page, made from the definitions of the commands."""
    if page == "cli":
        made = subprocess.run(_COMMAND_LINE, capture_output=True, text=True, check=True).stdout
        made = re.sub(r"</?span[^>]*>", "", html.unescape(made))
        made = made[made.index("\n**Usage**") :]
        sections = made[re.search(r"^## `gffe", made, re.MULTILINE).start() :]  # without typer's own list of commands
        source[0] = re.sub(r"^\| (`gffe (\w+)[^`]*`)", r"| [\1](#gffe-\2)", source[0], flags=re.MULTILINE) + sections


def _link_public_name(
    app: Sphinx, env: BuildEnvironment, node: nodes.Element, content: nodes.TextElement
) -> nodes.Element | None:
    """Link a name that a signature or a docstring has from its module, such as `gffe_cl.engine.frame.camera.Camera`."""
    name, _, member = re.sub(r"^(gffe|gffe_cl(\.[a-z_]+)*)\.|\(.*", "", node.get("reftarget", "")).partition(".")
    if node.get("refdomain") != "py" or name not in gffe_cl.__all__:
        return None
    target = ".".join(filter(None, ("gffe_cl", name, member)))
    return env.domains.python_domain.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, content)


def setup(app: Sphinx) -> None:
    app.connect("source-read", _link_pages_elsewhere)
    app.connect("source-read", _link_names)
    app.connect("source-read", _append_commands)
    app.connect("missing-reference", _link_public_name)
