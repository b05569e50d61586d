"""Pictures of folders, videos and recordings on a camera's topics, and what is said of those that cannot be shown."""

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from node_rig import NodeRig
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image

from stressbot_driver.errors import ErrorCode, StressbotError
from stressbot_driver.ros.pictures import image_message
from stressbot_driver.ros.qos import PICTURES
from stressbot_driver.ros.recorded_pictures import recorded_pictures
from stressbot_driver.vision.sources import Folder, open_source

pytestmark = pytest.mark.xdist_group("driver_processes")


def pattern(k):
    """A picture that says its number, also after a video's compression."""
    picture = np.full((48, 64), 40 + 20 * (k % 5), dtype=np.uint8)
    picture[:24] = 220 - 20 * (k % 5)
    return picture


def folder_of(path, count=5):
    path.mkdir()
    for k in range(count):
        cv2.imwrite(str(path / f"{k:03}.png"), pattern(k))
    return path


def recording_of(path, count=5, compressed=False):
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=4096)
        writer.start(profile="ros2", library="test")
        name = f"sensor_msgs/msg/{'CompressedImage' if compressed else 'Image'}"
        schema = writer.register_schema(name, "ros2msg", b"")
        other = writer.register_channel("/other", "cdr", writer.register_schema("std_msgs/msg/Empty", "ros2msg", b""))
        channel = writer.register_channel("/bench/image_raw", "cdr", schema)
        writer.add_message(other, 0, b"\0\1\0\0\0", 0)
        for k in range(count):
            message = image_message(pattern(k), Image().header.stamp)
            if compressed:
                message = CompressedImage(format="png", data=cv2.imencode(".png", pattern(k))[1].tobytes())
            message.header.stamp.nanosec = 40_000_000 * k
            writer.add_message(channel, k, serialize_message(message), k)
        writer.finish()
    return path


def video_of(path, count=5):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48))
    for k in range(count):
        writer.write(cv2.cvtColor(pattern(k), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


MAKERS = {"folder": folder_of, "video.mp4": video_of, "record.mcap": recording_of}


@pytest.mark.parametrize("name", ["folder", "video.mp4"])
def test_sources_give_their_pictures_in_order_and_again(tmp_path, name):
    source = open_source(str(MAKERS[name](tmp_path / name)))
    assert source.rate == {"folder": 30.0, "video.mp4": 25.0}[name]
    for _ in range(2):
        pictures = [source.next() for _ in range(6)]
        assert pictures[-1] is None
        for k, picture in enumerate(pictures[:-1]):
            assert np.abs(picture.astype(int) - pattern(k)).mean() < 4
        source.rewind()


def test_a_folder_says_which_picture_is_none(tmp_path):
    folder = folder_of(tmp_path / "folder", 2)
    (folder / "0005.png").write_text("no picture")
    cv2.imwrite(str(folder / "002.png"), pattern(2)[:20])
    (folder / "notes.txt").write_text("left alone")
    source = Folder(folder)
    source.next()
    for problem in ("0005.png is no picture", None, "002.png has another size (64 x 20 and 64 x 48)"):
        if problem is None:
            assert source.next() is not None
        else:
            with pytest.raises(StressbotError, match="picture|size") as refusal:
                source.next()
            assert problem in refusal.value.message
    assert source.next() is None


def test_a_recording_that_ends_early_gives_what_is_whole(tmp_path):
    path = recording_of(tmp_path / "record.mcap", count=60)
    whole = [picture.time for picture in recorded_pictures(path)]
    assert whole == [40_000_000 * k for k in range(60)]
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])
    found = [picture.time for picture in recorded_pictures(path)]
    assert found == whole[: len(found)] and 0 < len(found) < 60


@pytest.mark.parametrize(
    ("make", "code", "problem"),
    [
        (lambda path: path, ErrorCode.UNREADABLE_FILE, "is not there"),
        (lambda path: path.mkdir() or path, ErrorCode.UNREADABLE_FILE, "holds no picture"),
        (lambda path: path.write_text("no video") and path, ErrorCode.UNREADABLE_FILE, "can be opened"),
        (lambda path: "77", ErrorCode.UNREADABLE_FILE, "no camera 77 can be opened"),
        (lambda path: "a\0b", ErrorCode.UNREADABLE_FILE, "is not there"),
    ],
)
def test_what_is_no_source_is_refused(tmp_path, make, code, problem):
    with pytest.raises(StressbotError) as refusal:
        open_source(str(make(tmp_path / "thing")))
    assert (refusal.value.code, refusal.value.field) == (code, "source") and problem in refusal.value.message


@pytest.mark.parametrize("content", [b"no recording", b""])
def test_what_is_no_recording_of_pictures_is_refused(tmp_path, content):
    path = tmp_path / "record.mcap"
    path.write_bytes(content)
    with pytest.raises(StressbotError) as refusal:
        next(recorded_pictures(path))
    assert refusal.value.code == ErrorCode.MALFORMED_FILE
    with pytest.raises(StressbotError, match="no topic of pictures"):
        next(recorded_pictures(recording_of(path, count=0)))


@pytest.mark.parametrize("name", MAKERS)
def test_the_node_shows_each_picture_once_from_when_somebody_listens(tmp_path, name):
    rig = NodeRig()
    try:
        pictures = []
        rig.start("image_source", source=MAKERS[name](tmp_path / name))
        rig.node.create_subscription(Image, "image_raw", rig._keep(pictures), PICTURES)
        rig.wait(lambda: len(pictures) == 5, "five pictures")
        for k, image in enumerate(pictures):
            grey = np.frombuffer(image.data, dtype=np.uint8).reshape(image.height, image.step)
            assert np.abs(grey.astype(int) - pattern(k)).mean() < 4
        stamps = [image.header.stamp.sec + 1e-9 * image.header.stamp.nanosec for image in pictures]
        assert np.all(np.diff(stamps) > 0) and stamps[0] > 1e9
    finally:
        rig.close()


def test_the_node_repeats_and_passes_compressed_pictures_on(tmp_path):
    rig = NodeRig()
    try:
        pictures = []
        rig.start("image_source", source=recording_of(tmp_path / "record.mcap", compressed=True), repeat=True, rate=100.0)
        rig.node.create_subscription(CompressedImage, "image_raw/compressed", rig._keep(pictures), PICTURES)
        rig.wait(lambda: len(pictures) > 12, "pictures")
        assert bytes(pictures[0].data) == cv2.imencode(".png", pattern(0))[1].tobytes()
        assert len({bytes(image.data) for image in pictures}) == 5
        code, errors = rig.ended(rig.start("image_source", source=tmp_path / "nowhere"))
        assert (code, errors.count("\n")) == (2, 1) and "source: " in errors and "is not there" in errors
        code, errors = rig.ended(rig.start("image_source", source="'77'"))
        assert (code, errors.count("\n")) == (2, 1) and "no camera 77 can be opened" in errors
    finally:
        rig.close()
