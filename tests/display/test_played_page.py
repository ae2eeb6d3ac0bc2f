"""A play as one page: what the file says is what was played, and what a browser shows of it is what is drawn."""

import base64
import gzip
import json
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assets.splat_files import read_gaussians
from core.camera import look_at, perspective
from core.material import Material
from core.vocabulary import Body, Hand, Light, Plane
from display import user_commands as cmd
from display.keep.played_page import PlayedPage
from display.keep.scene_export import exporter
from display.picture import pixels_of
from display.protocol import Frame
from scenes.scene import Scene
from tests.support.chromium import NEEDS_CHROMIUM, Chromium
from tests.support.reference_render import covariances

ROOT = Path(__file__).resolve().parents[2]
SIZE = (320, 180)
SOFT = Material(young=2e4, poisson=0.4, density=1000.0)
NASTY = "</title></h1><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>\"&amp;"
EDITS = {4: cmd.Rotate(0, cmd.rotation_step((0.3, 1.0, 0.1))), 5: cmd.Duplicate(1), 6: cmd.Rescale(1, 1.3)}


@pytest.fixture(scope="module")
def played(ti_cpu, tmp_path_factory):
    """A page of a bottle and two rings, of which one is lifted, the other is copied and then scaled, and the play.

    Of each keyframe means, covariances, visibilities and a picture. Beside it now.html, as exported at the end.
    """
    from display.world import World

    bodies = [Body("bottle"), Body("ring_red", SOFT, (0.0, 0.2, 0.3)), Body("ring_blue", SOFT, (0.2, 0.3, 0.0))]
    light = Light((0.1, 2.0, 0.1), strength=0.8)
    eye, floor = (0.0, 0.45, 0.9), [Plane((0, 0, 0), (0, 1, 0))]
    scene = Scene(bodies, light, eye, (0.05, 0.12, 0.0), floor, background=(0.2, 0.3, 0.4))
    world = World(scene, width=SIZE[0], height=SIZE[1])
    camera = perspective(*SIZE, scene.fov_y, look_at(scene.eye, scene.target))
    page, moments = PlayedPage(world, NASTY), []
    for k in range(10):
        hand = Hand((0.14, 0.2 + 0.01 * k, 0.3), (np.cos(0.1 * k), 0.0, 0.0, np.sin(0.1 * k)), True, 0.05)
        world.step(Frame(1 / 30, k / 30, [camera], [hand], [EDITS[k]] if k in EDITS else []))
        page.take(k / 30)
        splats, live = world.device.splats, world.device.splats.count
        fields = [f.to_numpy()[:live] for f in (splats.mean, splats.cov, splats.visibility)]
        moments.append((*fields, pixels_of(world.picture)[..., :3].copy()))
    path = tmp_path_factory.mktemp("page") / "play.html"
    page.write(path)
    exporter(world, path.with_name("now.html"))()
    return path, moments


class Elements(HTMLParser):
    """Names of the elements of a page, the text of those with an id, and the title."""

    def __init__(self, text: str):
        super().__init__()
        self.names, self.texts, self._of = [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.names.append(tag)
        self._of = dict(attributes).get("id", tag)

    def handle_data(self, data):
        self.texts[self._of] = self.texts.get(self._of, "") + data

    def handle_endtag(self, tag):
        self._of = None


class Page:
    """A twin of the page's decoder: Gaussians `g`, header `about`, and by track their vertices and embeddings."""

    def __init__(self, path, tmp_path):
        texts = Elements(path.read_text("utf-8")).texts
        (tmp_path / "scene.spz").write_bytes(base64.b64decode(texts["scene"]))
        self.g = read_gaussians(tmp_path / "scene.spz")
        self.data = gzip.decompress(base64.b64decode(texts["motion"]))
        self.at = 4 + int.from_bytes(self.data[:4], "little")
        self.about = json.loads(self.data[4 : self.at])
        self.tracks, begin, slot = self.about["tracks"], self.about["still"], self.about["still"]
        for k, t in enumerate(self.tracks):
            if t["look"] == k:
                t["tet"] = self.take("<u4", t["tets"], 4)[self.take("<u4", t["count"], 4)]
                three = self.take("<i2", t["count"], 4, 3) * t["unit"]
                t["weight"] = np.concatenate([three, 1 - three.sum(2, keepdims=True)], 2)
                t["rows"] = slice(begin, begin + t["count"])
                begin += t["count"]
            shape = t["frames"], t["vertices"], 3
            low, high = (self.take(np.uint8, *shape).astype(int) for _ in range(2))
            t["x"] = np.array(t["low"]) + t["step"] * (np.cumsum(low + 256 * high, 0) % 65536)
            t["slots"] = slice(slot, slot + t["count"])
            slot += t["count"]
        light, self.light = np.full(slot, 255), []
        for n in self.about["changes"]:
            mask = np.unpackbits(self.take(np.uint8, -(-slot // 8)), count=slot).astype(bool)
            light[mask] = self.take(np.uint8, n)
            self.light.append(light.copy())
        assert self.at == len(self.data) and begin == len(self.g)

    def take(self, dtype, *shape):
        values = np.frombuffer(self.data, dtype, int(np.prod(shape)), self.at).reshape(shape)
        self.at += values.nbytes
        return values

    def moment(self, k):
        """Means [m], covariances [m^2] and light (0..255) of what is there at a keyframe."""
        still = slice(0, self.about["still"])
        sigma = covariances(self.g)
        found = [(self.g.means[still], sigma[still], self.light[k][still])]
        for t in self.tracks:
            if not t["first"] <= k < t["first"] + t["frames"]:
                continue
            look = self.tracks[t["look"]]
            shapes = look["x"][0], t["x"][k - t["first"]]
            y0, y = (np.einsum("nkj,nkjc->nkc", look["weight"], x[look["tet"]]) for x in shapes)
            D0, D = (np.swapaxes(c[:, 1:] - c[:, :1], 1, 2) for c in (y0, y))
            F = D @ np.linalg.inv(D0)
            offset = self.g.means[look["rows"]] - y0.mean(1)
            means = y.mean(1) + np.einsum("nij,nj->ni", F, offset)
            found.append((means, F @ sigma[look["rows"]] @ np.swapaxes(F, 1, 2), self.light[k][t["slots"]]))
        return [np.concatenate(a) for a in zip(*found, strict=True)]


def test_the_page_holds_the_play(played, tmp_path):
    path, moments = played
    page = Page(path, tmp_path)
    assert_array_equal([t["look"] for t in page.tracks], [0, 1, 0, 1, 1])
    assert [t["scale"] for t in page.tracks] == pytest.approx([1, 1, 1, 1, 1])
    assert_allclose(page.about["times"], np.arange(10) / 30, atol=1e-4)
    for k, (mean, cov, visibility, _) in enumerate(moments):
        means, sigma, light = page.moment(k)
        assert_allclose(means, mean, atol=1e-4)
        size = np.sqrt(cov[:, [0, 3, 5]].sum(1))
        error = np.abs(sigma[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] - cov).max(1) / size**2
        assert np.quantile(error, 0.99) < 0.1, "8 bits of log-scale: 3 %, of a variance 6 %"
        assert np.abs(light / 255 - visibility).max() < 0.03
    assert np.ptp([m[0][-1] for m in moments], 0).max() > 0.01, "something moved"


def test_a_moment_of_a_play_is_a_page_as_well(played, tmp_path):
    path, moments = played
    page = Page(path.with_name("now.html"), tmp_path)
    assert page.about["times"] == [0.0]
    assert_allclose(page.moment(0)[0], moments[-1][0], atol=1e-4)


def test_a_name_stays_a_name(played):
    page = Elements(played[0].read_text("utf-8"))
    assert page.names.count("script") == 3 and "img" not in page.names
    assert page.texts["title"].strip() == NASTY


@NEEDS_CHROMIUM
def test_a_browser_shows_the_play_from_all_sides(played, tmp_path):
    path, moments = played
    with Chromium() as browser:
        page = browser.open(path.as_uri(), *SIZE)
        page.until("get('say').hidden", 60)
        assert page.value("window.hacked") is None and page.value("document.title.trim()") == NASTY
        assert page.value("document.querySelectorAll('img').length") == 0
        page.until("time > 0.1")
        page.click("get('play')")
        assert not page.value("playing")
        page.value("['bar', 'hint'].forEach((id) => get(id).hidden = true), document.querySelector('h1').hidden = true")

        def shown(time: float) -> np.ndarray:
            page.value(f"time = {time}")
            page.until("!busy && !stale && asked.startsWith(`${times.findLastIndex((t) => t <= time)} `)")
            return page.screenshot()

        for k in (0, 5, 9):
            quality = cv2.PSNR(shown(k / 30 + 1e-4), moments[k][-1])
            print(f"keyframe {k}: {quality:.1f} dB")
            assert quality > 32
        before = shown(0.3)
        page.drag((160, 90), (220, 100))
        assert page.value("orbit.yaw") < -0.2 and cv2.PSNR(shown(0.3), before) < 25
        page.key("r", "KeyR")
        assert cv2.PSNR(shown(0.3), before) > 45
        page.mouse("Wheel", (160, 90), deltaX=0, deltaY=-200)
        assert page.value("orbit.distance < orbit.first")


@NEEDS_CHROMIUM
def test_a_browser_without_webgl_says_so(played):
    with Chromium() as browser:
        page = browser.open(played[0].as_uri(), *SIZE)
        page.do("Page.addScriptToEvaluateOnNewDocument", source="HTMLCanvasElement.prototype.getContext = () => null")
        page.do("Page.reload")
        page.until("document.readyState === 'complete' && get('say').textContent.includes('has no WebGL 2')")
        assert page.value("get('bar').hidden && !get('say').hidden")


@pytest.mark.long
@NEEDS_CHROMIUM
def test_the_page_of_the_ring_toss_is_small_and_looks_like_the_play(tmp_path):
    for options in ("export --out toss.html", "--headless --frames 121 --size 640x360 --snapshot toss.png"):
        run = [sys.executable, ROOT / "vrgs.py", *options.split(), "--arch", "cpu", "--scene", "ring_toss"]
        subprocess.run(run, cwd=tmp_path, check=True)
    assert (tmp_path / "toss.html").stat().st_size < 10e6
    with Chromium() as browser:
        page = browser.open((tmp_path / "toss.html").as_uri(), 640, 360)
        page.until("get('say').hidden", 120)
        page.value("setPlaying(false), time = 2 + 1e-4, get('bar').hidden = get('hint').hidden = true")
        page.value("document.querySelector('h1').hidden = true")
        page.until("!busy && !stale && asked.startsWith('60 ')", 120)
        picture = page.screenshot(tmp_path / "page.png")
    quality = cv2.PSNR(picture, cv2.imread(str(tmp_path / "toss.png"))[..., ::-1])
    print(f"{quality:.1f} dB")
    assert quality > 32
