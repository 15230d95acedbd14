"""Packages of a wheel: all folders of gffe_cl/, kernels/ and viewer/, with all files. pyproject.toml has the rest."""

from setuptools import find_namespace_packages, setup

PARTS = {"gffe_cl": "gffe_cl", "gffe_cl.kernels": "kernels", "gffe_cl.viewer": "viewer"}

setup(
    packages=[
        *PARTS,
        *(
            f"{name}.{inside}"
            for name, folder in PARTS.items()
            for inside in find_namespace_packages(folder, exclude=["*__pycache__*"])
        ),
    ],
    package_dir=PARTS,
    package_data={"": ["*"]},
)
