"""What is behind robots is learnt where none is, and lets them cross dust."""

import numpy as np
import pytest

from stressbot_driver.vision.background import Background
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.detection import Detector
from stressbot_driver.vision.filters import wrapped
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline

OUTLINE = Outline(12e-6, 6e-6)


def test_what_is_behind_a_robot_is_not_known_until_it_has_gone():
    background = Background(40, 60)
    picture = np.full((40, 60), 100, dtype=np.uint8)
    background.learn(picture, 0.0, np.array([[20.0, 10.0]]), 5.0)
    assert np.isnan(background.mean[10, 20]) and background.mean[30, 50] == 100.0
    assert not background.is_due(0.1) and background.is_due(0.3)
    picture[10, 20] = 50
    background.learn(picture, 0.3, np.array([[50.0, 30.0]]), 5.0)
    assert background.mean[10, 20] == 50.0 and background.mean[30, 50] == 100.0


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_on_dust_is_measured_as_well_as_beside_it(seed):
    random = np.random.default_rng(seed)
    camera = Camera(80, 80, 1e-6)
    microscope = Microscope(camera, [OUTLINE], Optics(dust=40), seed)  # a speck at every robot
    background = Background(80, 80)
    for k in range(20):
        background.learn(microscope.picture(np.array([[1.0, 1.0, 0.0]]), 0.03 * k), 0.03 * k, np.empty((0, 2)), 1.0)
    detector = Detector(camera, [OUTLINE])
    poses = np.column_stack([random.uniform(-2.5e-5, 2.5e-5, (20, 2)), random.uniform(-np.pi, np.pi, 20)])
    off = {True: [], False: []}
    for pose in poses:
        picture = microscope.picture(pose[None], 1.0)
        for known, errors in off.items():
            behind = background.mean if known else None
            found = detector.measure(picture, pose[None], np.zeros(1, dtype=int), background=behind)
            errors.append((found.poses - pose)[0] / (1e-6, 1e-6, 1.0))
    place = {known: np.sqrt(np.mean(np.square(np.array(errors)[:, :2]))) for known, errors in off.items()}
    heading = np.sqrt(np.mean(np.square(wrapped(np.array(off[True])[:, 2]))))
    assert place[True] < 0.35  # pixels
    assert place[True] < 0.5 * place[False]
    assert heading < 0.12
