"""The commands that calibrate a camera and check it, on pictures of a simulated microscope."""

import math

import cv2
import pytest
from driver_support import bench, scenario_text

from stressbot_driver.ros.camera_calibrate import calibrate_main, check_main
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import load_camera
from stressbot_driver.vision.microscope import Microscope
from stressbot_driver.vision.optics import Optics
from stressbot_driver.vision.outline import Outline

CAMERA = Camera(420, 360, 4e-6, (2e-4, 5e-4), 0.1)
ROBOT = Outline(100e-6, 50e-6, (10e-6, 0.0))


@pytest.fixture
def folder(tmp_path):
    """A scenario of six robots, pictures of them, and later ones."""
    (tmp_path / "scenario.yaml").write_text(scenario_text(6))
    microscope = Microscope(CAMERA, [ROBOT] * 6, Optics(drift_x=1e-6, dust=5, stripes=0.1))
    for name, times in (("first", (0.0, 0.1, 0.2)), ("soon", (1.0,)), ("later", (12.0, 12.1))):
        (tmp_path / name).mkdir()
        for time in times:
            cv2.imwrite(str(tmp_path / name / f"{time}.png"), microscope.picture(bench(6).start, time))
    return tmp_path


def code_of(main, *arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code


def test_a_camera_is_calibrated_and_its_drift_is_told(folder, capsys):
    output = folder / "camera.yaml"
    common = ("--scenario", folder / "scenario.yaml", "--source")
    outline = ("--outline", ROBOT.length, ROBOT.width, ROBOT.pivot[0])
    assert code_of(calibrate_main, *common, folder / "first", "--pitch", 40e-6, *outline, "--output", output) == 0
    camera, found = load_camera(output)
    assert found == ROBOT and (camera.width, camera.height) == (420, 360)
    assert camera.pixel == pytest.approx(4e-6, rel=1e-3) and camera.rotation == pytest.approx(0.1, abs=2e-3)
    assert math.dist(camera.center, CAMERA.center) < 2e-6
    assert "6 of 6 robots" in capsys.readouterr().out
    assert code_of(check_main, *common, folder / "soon", "--camera", output, "--most", 8e-6) == 0
    assert code_of(check_main, *common, folder / "later", "--camera", output, "--most", 8e-6) == 3
    said = capsys.readouterr()
    assert "the stage has moved by 1" in said.out and said.err.count("\n") == 1 and "calibrate again" in said.err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--pitch", "40"), "pitch: is 40: give m"),
        (("--pixel", "nan"), "pixel: is nan"),
        (("--pixel", "4e-6", "--outline", "1e-5", "2e-5", "0"), "outline: needs"),
        (("--pixel", "4e-6", "--output", "/nowhere/camera.yaml", "--outline", "1e-4", "5e-5", "1e-5"), "output: /nowhere"),
    ],
)
def test_what_cannot_be_is_one_line(folder, capsys, arguments, problem):
    assert code_of(calibrate_main, "--scenario", folder / "scenario.yaml", "--source", folder / "first", *arguments) == 2
    errors = capsys.readouterr().err
    assert problem in errors and errors.count("\n") == 1


def test_pictures_of_nothing_are_told_from_bad_input(folder, capsys):
    (folder / "empty").mkdir()
    cv2.imwrite(str(folder / "empty" / "a.png"), Microscope(CAMERA, [], Optics(stripes=0.0)).picture(bench(6).start[:0], 0.0))
    common = ("--scenario", folder / "scenario.yaml", "--source", folder / "empty")
    assert code_of(calibrate_main, *common, "--pitch", 40e-6) == 3
    assert "shows no electrodes" in capsys.readouterr().err
    (folder / "camera.yaml").write_text("width: 64\nheight: 64\npixel: 4e-6\ncenter: [0, 0]\nrotation: 0\n")
    assert code_of(check_main, *common, "--camera", folder / "camera.yaml") == 2
    assert "420 x 360 pixels" in capsys.readouterr().err
