"""The page in a real browser above a simulated microscope: robots lie where its picture shows them."""

import contextlib

import pytest
import yaml
from browser import Page, browser, needs_chromium, serve
from three_robots import SCENARIO

pytestmark = [needs_chromium, pytest.mark.xdist_group("view")]

CAMERA = {"width": 900, "height": 800, "pixel": 1.8e-6, "center": [6.0e-4, 6.0e-4], "rotation": 0.4, "distortion": 0.08}
OUTLINE = {"outline": {"length": 120e-6, "width": 60e-6}}
"""As the page draws robots."""

LEVELS = """() => {
  const { image, place: [a, b, x, c, d, y] } = plane.picture, canvas = new OffscreenCanvas(image.width, image.height);
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, image.width, image.height), size = a * d - b * c;
  const level = (px, py) => {
    const u = Math.round((d * (px - x) - b * (py - y)) / size), v = Math.round((a * (py - y) - c * (px - x)) / size);
    return data[4 * (v * image.width + u)];
  };
  const found = [], { poses, swarm } = plane.seen;
  for (let row = 0; row < swarm.count; row++) {
    const [px, py, turn] = poses.slice(3 * row, 3 * row + 3), length = swarm.icons[row];
    const at = (along) => level(px + along * length * Math.cos(turn), py + along * length * Math.sin(turn));
    found.push([at(0.35), at(-0.35), at(0.9), at(-0.9)]);
  }
  return found;
}"""
"""Grey levels of the picture at each robot: near its nose, near its tail, before and behind it."""


@pytest.fixture(scope="module")
def system(new_system, tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera")
    (folder / "three.yaml").write_text(SCENARIO)
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA | OUTLINE))
    system = new_system(nodes=())
    system.start("driver", scenario=folder / "three.yaml", tracked=True)
    system.start("simulated_camera", camera=folder / "camera.yaml", rate=15.0, drift_x=2e-6, stripes=0.1)
    system.start("camera_tracker", camera=folder / "camera.yaml")
    system.wait_for(lambda: system.client.poses, "poses from pictures")
    return system


@pytest.fixture
def page(system):
    address = serve(system, f"view_{len(system.processes.ended())}").partition("#")[0]  # a guest may look as well
    with browser() as chromium, contextlib.closing(Page(chromium, address)) as page:
        page.wait("state.frame && state.services.includes('pictures')")
        yield page


def looks(system):
    topic = f"{system.namespace}/image_raw/compressed"
    return [end.node_name for end in system.client.node.get_subscriptions_info_by_topic(topic)]


def test_the_picture_lies_beneath_the_robots_as_long_as_somebody_wants_it(system, page):
    assert looks(system) == []
    page.picture("camera-off")
    page.page.check("#camera")
    page.wait("pictures.count > 3 && plane.picture")
    assert looks(system) == ["view"]
    for levels in page.get(LEVELS):
        inside, outside = levels[:2], levels[2:]
        assert max(inside) < 0.75 * min(outside), levels
    page.picture("camera-on")
    count, begin = page.get("[pictures.count, performance.now()]")
    page.wait(f"pictures.count >= {count + 16}")
    assert page.get("performance.now()") - begin > 12 * 250  # ms: four a second, of which some may have come late
    system.processes.stop("simulated_camera")
    page.wait("!plane.picture && !state.services.includes('pictures')")  # no old picture beneath robots of now
    page.page.uncheck("#camera")
    system.wait_for(lambda: looks(system) == [], "nobody who looks")
    page.wait("byId('eye').hidden")
