"""Middles of polygons and of what pictures show."""

import numpy as np


def area_and_middle(corners):
    """Of a polygon (shoelace formula)."""
    x, y = corners.T
    following = np.roll(corners, -1, axis=0)
    cross = x * following[:, 1] - following[:, 0] * y
    area = cross.sum() / 2
    return abs(area), ((corners + following) * cross[:, None]).sum(axis=0) / (6 * area)


def middle_of(cover):
    rows, columns = np.indices(cover.shape)
    return np.array([(cover * columns).sum(), (cover * rows).sum()]) / cover.sum()
