"""Robots found and measured in pictures, over many seeds."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.detection import Detector, Measured
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline
from stressbot_driver.vision.planar import wrapped

PIXEL = 1e-6
ROBOTS = 8


class Scene:
    """Robots at random places, apart by more than a length, seen through everything that a microscope does to them."""

    def __init__(self, seed: int, length: float, spacing: float = 1.3, **optics) -> None:
        self.random = np.random.default_rng(seed)
        side = max(100, int(8 * length))
        self.camera = Camera(side, side, PIXEL, (3e-4, 2e-4), 0.3, 0.01)
        self.outline = Outline(length * PIXEL, 0.5 * length * PIXEL, (0.1 * length * PIXEL, 0.05 * length * PIXEL))
        pixels = np.empty((0, 2))
        while len(pixels) < ROBOTS:
            point = self.random.uniform(0.8 * length, side - 0.8 * length, 2)
            if not len(pixels) or np.hypot(*(pixels - point).T).min() > spacing * length:
                pixels = np.vstack([pixels, point])
        self.poses = np.column_stack([self.camera.to_substrate(pixels), self.random.uniform(-np.pi, np.pi, ROBOTS)])
        self.microscope = Microscope(self.camera, [self.outline] * ROBOTS, Optics(**{"dust": 2} | optics), seed)
        self.detector = Detector(self.camera, [self.outline])

    def picture(self) -> np.ndarray:
        return self.microscope.picture(self.poses, 0.0)

    def measured(self, place: float = 0.05, heading: float = 0.1) -> Measured:
        """From a guess that is off by so many lengths and rad."""
        length = self.outline.length
        guess = self.poses + self.random.normal(0.0, 1.0, self.poses.shape) * (place * length, place * length, heading)
        return self.detector.measure(self.picture(), guess, np.zeros(ROBOTS, dtype=int), firm=np.ones(ROBOTS, dtype=bool))

    def errors(self, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
        """Of places in body radii, (k, 2), and of headings in degrees, (k,)."""
        off = measured.poses - self.poses
        return off[:, :2] / (0.5 * np.hypot(1.0, 0.5) * self.outline.length), np.degrees(wrapped(off[:, 2]))


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate(values)))))


@pytest.mark.parametrize("optics", [{}, {"contrast": 0.5, "lamp": 100.0}, {"blur": 1.0}, {"uneven": 0.6}, {"stripes": 0.0}])
def test_pivot_and_heading_are_measured_to_a_fiftieth_of_a_body_radius_and_a_degree(optics):
    places, headings = zip(*(
        scene.errors(scene.measured()) for seed in range(12) for scene in [Scene(seed, 20.0, **optics)]
    ), strict=True)
    assert _rms(places) <= 0.02
    assert _rms(headings) <= 1.0


@pytest.mark.parametrize("length, place, heading", [(3.0, 0.12, 9.0), (6.0, 0.08, 4.0), (10.0, 0.03, 2.0), (60.0, 0.03, 2.5)])
def test_small_and_large_robots_are_measured_as_well_as_their_pixels_allow(length, place, heading):
    places, headings = zip(*(scene.errors(scene.measured()) for seed in range(6) for scene in [Scene(seed, length)]), strict=True)
    assert _rms(places) <= place
    assert _rms(headings) <= heading


@pytest.mark.parametrize("seed", range(4))
def test_what_is_said_of_the_error_holds(seed):
    scene = Scene(seed, 20.0)
    measured = scene.measured()
    off = measured.poses - scene.poses
    off[:, 2] = wrapped(off[:, 2])
    distances = np.einsum("ki,kij,kj->k", off, np.linalg.inv(measured.covariance), off)
    assert np.mean(distances) < 3 * 4.0  # 3 degrees of freedom; less than twice the deviation


@pytest.mark.parametrize("seed", range(6))
def test_robots_are_found_in_a_whole_picture_with_head_and_tail(seed):
    scene = Scene(seed, 20.0)
    found = scene.detector.find(scene.picture())
    apart = np.hypot(*(found.poses[:, None, :2] - scene.poses[:, :2]).transpose(2, 0, 1)) / scene.outline.length
    rows, robots = linear_sum_assignment(apart)
    right = (apart[rows, robots] < 0.1) & (np.abs(wrapped(found.poses[rows, 2] - scene.poses[robots, 2])) < 0.1)
    assert right.sum() >= ROBOTS - 1
    assert len(found.poses) <= ROBOTS + 1


@pytest.mark.parametrize("seed", range(4))
def test_robots_that_touch_do_not_pull_each_other(seed):
    scene = Scene(seed, 20.0)
    # side by side, half a pixel apart
    scene.poses[1] = scene.poses[0]
    across = (0.5 + 0.5 / 20.0) * scene.outline.length
    scene.poses[1, :2] += across * np.array([-np.sin(scene.poses[0, 2]), np.cos(scene.poses[0, 2])])
    places, headings = scene.errors(scene.measured(place=0.03, heading=0.05))
    assert np.abs(places[:2]).max() < 0.1
    assert np.abs(headings[:2]).max() < 4.0


def test_nothing_is_found_where_nothing_is():
    scene = Scene(0, 20.0)
    scene.poses[:, 0] += 1.0
    measured = scene.detector.measure(scene.picture(), scene.poses - (1.0, 0.0, 0.0), np.zeros(ROBOTS, dtype=int))
    assert measured.quality.max() < 0.35
