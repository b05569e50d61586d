"""The simulated camera as a process: pictures of where the robots are, when their stamps say, and what a camera does wrong."""

import math

import cv2
import numpy as np
import pytest
from driver_support import bench, encode, scenario_text
from node_rig import NodeRig
from picture_support import area_and_middle, middle_of
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import CompressedImage, Image
from stressbot_msgs.msg import DriverStatus, SwarmPoses

from stressbot_driver.ros.qos import PICTURES, POSES
from stressbot_driver.vision.camera import Camera
from stressbot_driver.vision.camera_file import write_camera
from stressbot_driver.vision.microscope import BLACK
from stressbot_driver.vision.outline import Outline

pytestmark = pytest.mark.xdist_group("driver_processes")
CAMERA = Camera(320, 240, 5e-6, center=(3e-4, 2e-4), rotation=0.2, distortion=0.01)
PLAIN = {"noise": 0.0, "dust": 0, "stripes": 0.0, "uneven": 0.0, "contrast": -1.0, "lamp": 200.0, "rate": 25.0}


def time_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def grey(image):
    return np.frombuffer(image.data, dtype=np.uint8).reshape(image.height, image.step)


@pytest.fixture
def rig(tmp_path):
    rig = NodeRig()
    rig.pictures, rig.true = [], {}

    def keep_poses(message):
        with rig.heard:
            rig.true[time_of(message)] = np.column_stack([message.x, message.y, message.heading])

    rig.node.create_subscription(Image, "image_raw", rig._keep(rig.pictures), PICTURES)
    rig.node.create_subscription(SwarmPoses, "true_poses", keep_poses, POSES)
    rig.camera = tmp_path / "camera.yaml"
    write_camera(rig.camera, CAMERA, Outline(100e-6, 50e-6))
    rig.scenario = tmp_path / "scenario.yaml"
    rig.scenario.write_text(scenario_text(2))
    yield rig
    rig.close()


def drive(rig, **parameters):
    """A driver of two robots and a camera above them."""
    process = rig.start("driver", "-r", "swarm_poses:=true_poses", scenario=rig.scenario, auto_start=True)
    rig.wait(lambda: process.poll() is not None or (rig.descriptions and rig.statuses), "the description")
    return rig.start("simulated_camera", camera=rig.camera, **{**PLAIN, **parameters})


def newest(rig, condition=lambda _: True, what="a picture"):
    rig.pictures.clear()
    return rig.wait(lambda: next(filter(condition, list(rig.pictures)), None), what)


def error_of(image, poses):
    """[pixels] from the middle of what is dark to the middle of the robots' outlines."""
    parts = [area_and_middle(CAMERA.to_pixels(Outline(100e-6, 50e-6).at(pose))) for pose in poses]
    areas, middles = (np.array(part) for part in zip(*parts, strict=True))
    return np.hypot(*(middle_of((200.0 + BLACK - grey(image)).clip(0)) - areas @ middles / areas.sum()))


def test_pictures_show_the_robots_at_the_moment_of_their_stamps(rig):
    drive(rig)
    first = newest(rig)
    assert (first.header.frame_id, first.encoding, first.width, first.height, first.step) == ("camera", "mono8", 320, 240, 320)
    rig.wait(rig.publisher.get_subscription_count, "the match of voltage_sequence")
    rig.wait(lambda: "sequencer_status" not in rig.statuses[-1].missing, "the driver's sight of this rig")
    rig.send(encode(bench(2), [(1, 1.0), (2, 1.0)]))
    rig.state(DriverStatus.RUNNING)
    rig.pictures.clear()
    rig.state(DriverStatus.DONE)
    moving = [image for image in list(rig.pictures) if time_of(image) in rig.true]
    assert len(moving) > 10  # a busy machine loses some
    places = np.array([rig.true[time_of(image)] for image in moving])
    assert np.ptp(places[:, 0, :2], axis=0).max() > 5e-5, "they moved"
    errors = [error_of(image, poses) for image, poses in zip(moving, places, strict=True)]
    assert max(errors) < 0.05
    stamps = [time_of(image) for image in moving]
    assert stamps == sorted(set(stamps))


def test_what_a_camera_does_wrong_can_be_switched_on_while_it_runs(rig):
    drive(rig)
    newest(rig)
    parameters = AsyncParameterClient(rig.node, "simulated_camera")
    rig.wait(parameters.services_are_ready, "the parameter services")

    def put(**values):
        future = parameters.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        rig.wait(future.done, "the answer")
        return [(result.successful, result.reason) for result in future.result().results]

    assert put(lamp=0.0) == [(True, "")]
    assert newest(rig, lambda image: grey(image).max() < 10, "a dark picture")
    assert put(lamp=200.0, noise=3.0) == [(True, "")] * 2
    newest(rig, lambda image: grey(image).mean() > 100, "light")
    assert put(frozen=True) == [(True, "")]
    newest(rig)
    rig.pictures.clear()
    rig.wait(lambda: len(rig.pictures) > 3, "pictures")
    frozen = list(rig.pictures)[1:]
    assert all(np.array_equal(grey(image), grey(frozen[0])) for image in frozen)
    assert len({time_of(image) for image in frozen}) == len(frozen)
    assert put(frozen=False, strangers=[5e-4, 3e-4, 1.0]) == [(True, "")] * 2
    ((u, v),) = np.round(CAMERA.to_pixels(np.array([[5e-4, 3e-4]]))).astype(int)
    newest(rig, lambda image: grey(image)[v, u] < 50, "a stranger")
    for name, value, problem in (("lamp", 300.0, "lamp"), ("strangers", [1.0, 2.0], "3 each"), ("lost", math.nan, "lost")):
        ((done, reason),) = put(**{name: value})
        assert not done and problem in reason


def test_pictures_are_late_and_in_order_and_some_are_lost(rig):
    drive(rig, latency=0.3, late=0.1, lost=0.5, rate=50.0)
    received = []
    rig.node.create_subscription(
        Image, "image_raw", lambda image: received.append((rig.node.get_clock().now().nanoseconds, time_of(image))), PICTURES
    )
    rig.wait(lambda: len(received) > 40, "pictures")
    delays = np.array([at - stamp for at, stamp in received]) * 1e-9
    stamps = np.array([stamp for _, stamp in received])
    assert delays.min() >= 0.3 and np.all(np.diff(stamps) > 0)
    assert np.diff(stamps).mean() * 1e-9 > 1.3 / 50


def test_stamps_that_are_late_are_so_by_as_much_as_asked_for(rig):
    drive(rig, stamp_late=0.15)
    received = []
    rig.node.create_subscription(
        Image, "image_raw", lambda image: received.append((rig.node.get_clock().now().nanoseconds, time_of(image))), PICTURES
    )
    rig.wait(rig.publisher.get_subscription_count, "the match of voltage_sequence")
    rig.wait(lambda: "sequencer_status" not in rig.statuses[-1].missing, "the driver's sight of this rig")
    rig.wait(lambda: received, "pictures")
    rig.send(encode(bench(2), [(1, 1.0), (2, 1.0)]))
    rig.state(DriverStatus.RUNNING)
    rig.pictures.clear()
    rig.state(DriverStatus.DONE)
    moving = [(image, rig.true.get(time_of(image) - 150_000_000)) for image in list(rig.pictures)]
    errors = [error_of(image, poses) for image, poses in moving if poses is not None]
    assert len(errors) > 20 and max(errors) < 0.05
    assert all(at >= stamp for at, stamp in received)


def test_pictures_are_compressed_for_those_who_ask(rig):
    drive(rig, format="png", noise=2.0)
    compressed = []
    rig.node.create_subscription(CompressedImage, "image_raw/compressed", rig._keep(compressed), PICTURES)
    message = rig.wait(lambda: compressed and compressed[-1], "a compressed picture")
    assert (message.format, message.header.frame_id) == ("png", "camera")
    same = rig.wait(
        lambda: next(((one, raw) for one in compressed for raw in rig.pictures if time_of(one) == time_of(raw)), None), "both"
    )
    assert np.array_equal(cv2.imdecode(np.frombuffer(same[0].data, np.uint8), cv2.IMREAD_GRAYSCALE), grey(same[1]))


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({}, "camera: is not set"),
        ({"camera": "/nowhere.yaml"}, "camera: /nowhere.yaml cannot be read"),
        ({"camera": "bench", "format": "gif"}, "format: is 'gif': give jpeg or png"),
        ({"camera": "bench", "blur": -1.0}, "blur"),
        ({"camera": "bench", "blurr": 1.0}, "blurr"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_two(parameters, problem):
    rig = NodeRig()
    try:
        code, errors = rig.ended(rig.start("simulated_camera", **parameters))
        assert (code, errors.count("\n")) == (2, 1) and problem in errors
    finally:
        rig.close()
