"""The replay page: what is in the file, and what it does in a browser."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.policies.looks import LOOKS
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.agents.viewing import replay
from uwoc_gym.agents.viewing.episode import Episode

pytest.importorskip("plotly")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a whole episode of 150 s."""
    path = tmp_path_factory.mktemp("replay") / "page.html"
    assert main(["replay", "--policy", "pd-plain", "nlpd", "--out", str(path)]) == 0
    return path


def data_of(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


class Sources(HTMLParser):
    """Everything that a page would load by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]


def test_the_page_is_one_small_file(page: Path) -> None:
    assert page.stat().st_size < 8e6
    parser = Sources()
    parser.feed(page.read_text(encoding="utf-8"))
    assert [source for source in parser.found if not source.startswith("data:")] == []
    # Styles and the page's own script load nothing either; the library's text is full of addresses that it doesn't use.
    own = re.sub(r"<script>.*?</script>", "", page.read_text(encoding="utf-8"), count=1, flags=re.DOTALL)
    assert "http" not in own
    assert "@import" not in own
    assert "@@" not in own


def test_the_data_are_those_of_the_flights(page: Path) -> None:
    data = data_of(page)
    assert [policy["name"] for policy in data["policies"]] == ["pd-plain", "nlpd"]
    scenario = Scenario.named("StrongPulse")
    flight = fly(load("nlpd"), scenario, [0])
    series, own = flight.series, data["policies"][1]
    assert data["period_s"] == pytest.approx(0.1)
    assert len(own["x"]) == 1501
    np.testing.assert_allclose(own["x"], series.pose[::2, 0], atol=6e-4)
    np.testing.assert_allclose(data["ship"]["y"], series.ship_pose[::2, 1], atol=6e-4)
    np.testing.assert_allclose(own["range_m"], series.range_m[::2], atol=6e-4)
    rate = series.bit_rate_bps[::2]
    assert [value is None for value in own["log_rate"]] == (rate == 0.0).tolist()
    assert own["delivered_gbit"][-1] == pytest.approx(flight.metrics.delivered_gbit[0], abs=0.01)
    outcome = {row[0]: row[1:] for row in data["outcome"]}
    assert float(outcome["t_a [s]"][1]) == pytest.approx(flight.metrics.arrival_time_s[0], abs=0.006)
    assert data["pulses"] == [{"begin_s": 30.0, "end_s": 31.0, "words": "pulse: 1500 N, 1500 N, 1500 N m"}]
    cone = scenario.link.cone()
    assert data["radius_m"] == pytest.approx(cone.footprint_radius_m(cone.height_m), abs=1e-3)


def test_a_lost_link_and_strange_names_are_written_safely(tmp_path: Path) -> None:
    far = Scenario().merged({"start": {"x_m": 0.0, "y_m": 0.15, "sway_mps": -5.0}, "episode": {"lost_distance_m": 9.9}})
    policy = load("pd")
    flights = {"</script><b>": fly(policy, far, [0])}
    data = replay.page_data(Episode([policy], "<far>", far, 0), flights)
    text = replay.page(data, "var library;</script>")
    assert text.count("</script>") == 3
    assert data["outcome"][-1] == ["end", "link lost"]
    assert data["policies"][0]["log_rate"] == [None]
    path = tmp_path / "page.html"
    path.write_text(text, encoding="utf-8")
    assert data_of(path)["policies"][0]["name"] == "</script><b>"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver")
    binary = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    driver = shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("Chromium and chromedriver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--window-size=1200,1000",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    made = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    made.set_script_timeout(60)
    yield made
    made.quit()


def picture_of(element: Any) -> Any:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(element.screenshot_as_png)).convert("RGB")).astype(int)


def hues(picture: Any, colour: tuple[int, int, int]) -> int:
    """How many pixels have about the hue of a colour, whatever the light on it."""
    norm = picture / np.maximum(np.linalg.norm(picture, axis=-1, keepdims=True), 1.0)
    strong = np.ptp(picture, axis=-1) > 70
    return int((strong & ((norm @ (np.array(colour) / np.linalg.norm(colour))) > 0.985)).sum())


def seek(browser: Any, time_s: float) -> None:
    """Move the slider as a user does and wait until the scene has followed."""
    browser.execute_async_script(
        "const [value, done] = arguments, slider = document.getElementById('time'); slider.value = value;"
        "slider.dispatchEvent(new Event('input'));"
        "const wait = () => busy ? setTimeout(wait, 20) : requestAnimationFrame(() => setTimeout(done, 200)); wait();",
        time_s,
    )


def test_the_page_in_a_browser(page: Path, browser: Any) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get(page.as_uri())
    WebDriverWait(browser, 60).until(lambda it: it.execute_script("return document.body.dataset.ready") == "yes")

    # Two policies are two vehicles: each a mesh of its own and of its own colour in the picture.
    vehicles = "return document.getElementById('scene').data.filter(t => t.type === 'mesh3d' && t.name)"
    meshes = browser.execute_script(f"{vehicles}.map(t => t.name)")
    assert meshes == ["pd-plain", "nlpd"]
    scene = browser.find_element(By.ID, "scene")
    seek(browser, 31.3)
    pulse = picture_of(scene)
    for name in ("pd-plain", "nlpd"):
        assert hues(pulse, LOOKS[name].rgb) > 60, name
    positions = browser.execute_script(f"{vehicles}.map(t => [t.x[0], t.y[0]])")
    assert np.hypot(*np.subtract(*positions)) > 0.3

    # The slider moves scene, cursor, clock and readings.
    cursor = browser.find_element(By.ID, "cursor")
    before = cursor.location["x"]
    seek(browser, 100.0)
    later = picture_of(scene)
    assert (np.abs(later - pulse).max(axis=-1) > 40).mean() > 0.01
    assert cursor.location["x"] - before > 100
    assert browser.find_element(By.ID, "clock").text.startswith("100.00 s")
    now = browser.find_element(By.ID, "now").text
    assert now.count("in link") == 2
    assert "RMSE x [m]" in browser.find_element(By.ID, "outcome").text

    # Back at the same time the picture is the same.
    seek(browser, 31.3)
    assert (np.abs(picture_of(scene) - pulse).max(axis=-1) > 40).mean() < 0.002
    assert browser.find_element(By.ID, "now").text.count("no l") >= 1

    # Keys and the button.
    body = browser.find_element(By.TAG_NAME, "body")
    body.send_keys(Keys.ARROW_RIGHT)
    assert browser.execute_script("return now") == pytest.approx(31.8)
    browser.find_element(By.ID, "play").click()
    WebDriverWait(browser, 30).until(lambda it: it.execute_script("return now") > 32.2)
    body.send_keys(Keys.SPACE)
    assert browser.execute_script("return playing") is False
    body.send_keys(Keys.HOME)
    assert browser.execute_script("return now") == 0

    # Nothing was asked of a network, and nothing went wrong.
    requests = [
        message["params"]["request"]["url"]
        for message in (json.loads(entry["message"])["message"] for entry in browser.get_log("performance"))
        if message["method"] == "Network.requestWillBeSent"
    ]
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert len([url for url in requests if url.startswith("file:")]) <= 1
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_nothing_hides_a_chart_on_a_small_screen(page: Path, browser: Any) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.ui import Select, WebDriverWait

    # What the page gets is the screen, whatever a browser's own bars take of a window.
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 1280, "height": 720, "deviceScaleFactor": 1, "mobile": False}
    )
    try:
        browser.get(page.as_uri())
        WebDriverWait(browser, 60).until(lambda it: it.execute_script("return document.body.dataset.ready") == "yes")
        scene, charts, bar = (browser.find_element(By.ID, name).rect for name in ("scene", "charts", "transport"))
        assert scene["height"] > 180
        assert charts["height"] > 240
        assert scene["y"] + scene["height"] <= charts["y"]
        assert charts["y"] + charts["height"] <= bar["y"]
        assert bar["y"] + bar["height"] <= 720
        drawn = browser.execute_script("return document.getElementById('charts')._fullLayout.height")
        assert drawn == pytest.approx(charts["height"], abs=2)

        # A close-up of the charts goes along with the time shown.
        Select(browser.find_element(By.ID, "span")).select_by_value("3")
        seek(browser, 31.5)
        shown = browser.execute_script("return document.getElementById('charts')._fullLayout.xaxis.range")
        assert shown == pytest.approx([30.0, 33.0])
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
