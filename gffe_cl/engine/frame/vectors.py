"""Vectors of three and their matrices in float64, each operation written out: `export/c/gffe_camera.c` repeats them in
the same order, and has the same bits. (Libraries of linear algebra differ from one machine to another.)"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = Sequence[float]  # three
Matrix = Sequence[Vector]  # three rows


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: Vector) -> float:
    return math.sqrt(dot(a, a))


def cross(a: Vector, b: Vector) -> list[float]:
    (ax, ay, az), (bx, by, bz) = a, b
    return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]


def times(matrix: Matrix, vector: Vector) -> list[float]:
    """Return the product matrix · vector."""
    return [dot(row, vector) for row in matrix]


def product(a: Matrix, b: Matrix) -> list[list[float]]:
    """Return the matrix product a · b."""
    columns = list(zip(*b, strict=True))
    return [[dot(row, column) for column in columns] for row in a]


def transposed(matrix: Matrix) -> list[list[float]]:
    return [list(column) for column in zip(*matrix, strict=True)]


def determinant(matrix: Matrix) -> float:
    return dot(matrix[0], cross(matrix[1], matrix[2]))


def view_inverse(matrix: Matrix) -> tuple[list[list[float]], list[float]]:
    """Return rotation and translation of the inverse of a rigid transform, given as (3 or 4, 4) rows: by cofactors,
    accurate to rounding for nearly rigid matrices."""
    (*a, x), (*b, y), (*c, z) = matrix[:3]
    of_x, of_y, of_z = cross(b, c), cross(c, a), cross(a, b)
    scale = dot(a, of_x)
    rotation = [[p / scale, q / scale, r / scale] for p, q, r in zip(of_x, of_y, of_z, strict=True)]
    return rotation, [-(p * x + q * y + r * z) for p, q, r in rotation]


def view_to_view(source: Matrix, inverse: tuple[Matrix, Vector], target: Matrix) -> list[list[float]]:
    """Return the first three rows of the transform from one view space to another: the identity for equal poses.
    `source`, `target`: the rows of world → view; `inverse`: `view_inverse` of the former."""
    if source == target:
        return [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    ((ax, ay, az), (bx, by, bz), (cx, cy, cz)), (x, y, z) = inverse
    return [
        [a * ax + b * bx + c * cx, a * ay + b * by + c * cy, a * az + b * bz + c * cz, (a * x + b * y + c * z) + place]
        for a, b, c, place in target[:3]
    ]
