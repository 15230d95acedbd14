"""Packages of a wheel: every folder of gffe_cl/, kernels/ and viewer/ with all its files. The rest is in pyproject.toml."""

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
