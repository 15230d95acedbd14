"""Packages of a wheel: all folders of gffe_cl/, kernels/ and viewer/, with all files but hidden ones and backups; links
to folders are left out. pyproject.toml has the rest."""

import os

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


setup(
    packages=list(packages()),
    package_dir=PARTS,
    package_data={"": ["*"]},
    exclude_package_data={"": [".*", "*~"]},
)
