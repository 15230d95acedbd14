"""Packages of a wheel: all folders of gffe_cl/, kernels/ and viewer/, with all files but hidden ones and backups; links
to folders are left out. Links of its README are absolute if it is built on GitHub. pyproject.toml has the rest."""

import os
import re
from pathlib import Path

from setuptools import setup

PARTS = {"gffe_cl": "gffe_cl", "gffe_cl.kernels": "kernels", "gffe_cl.viewer": "viewer"}


def packages():
    """Yield the names of all packages. Folders behind links are none: one may lead to a folder above itself."""
    for name, top in PARTS.items():
        for folder, inner, _ in os.walk(top):
            inner[:] = [each for each in inner if "." not in each and each != "__pycache__"]
            inner[:] = [each for each in inner if not os.path.islink(os.path.join(folder, each))]
            inside = os.path.relpath(folder, top)
            yield name if inside == "." else f"{name}.{inside.replace(os.sep, '.')}"


def urls():
    """Return the addresses of the project by name; the repository's where GitHub builds it."""
    name = os.environ.get("GITHUB_REPOSITORY")
    found = {"Paper": "https://doi.org/10.1145/3687923"}
    if name:
        source = f"{os.environ.get('GITHUB_SERVER_URL', 'https://github.com')}/{name}"
        found |= {"Source": source, "Issues": f"{source}/issues", "Documentation": f"{source}/tree/main/docs"}
        found["Changelog"] = f"{source}/blob/main/CHANGELOG.md"
    return found


def readme():
    """Return the README; on the page of an index no files lie beside it."""
    text, source = Path(__file__).with_name("README.md").read_text("utf-8"), urls().get("Source")
    if source is None:
        return text
    text = re.sub(r"(!\[[^\]]*\]\()(?!https?:)", rf"\1{source}/raw/main/", text)
    return re.sub(r"(\]\()(?!https?:|#)", rf"\1{source}/blob/main/", text)


setup(
    long_description=readme(),
    long_description_content_type="text/markdown",
    project_urls=urls(),
    packages=list(packages()),
    package_dir=PARTS,
    package_data={"": ["*"]},
    exclude_package_data={"": [".*", "*~"]},
)
