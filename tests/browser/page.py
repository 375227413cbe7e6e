"""Drives the page of examples/browser in headless Chromium. Arguments: the folder of the page, and the report of a rollout of
the default scene with which the energies of its first frames are compared."""

import contextlib
import functools
import http.server
import json
import math
import pathlib
import struct
import sys
import tempfile
import threading
import time
import zlib

from webdriver import Browser

# Small and few, for a software device.
QUICK = {"solver": "spectral", "iterations": 3, "grid": 12}
SCENES_REFUSED = {"authors", "npy_start", "obj_start", "recorded"}


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@contextlib.contextmanager
def served(folder):
    """Serves a folder and returns its address."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


def pixels(png):
    """Returns the rows of a PNG of 8 bits a channel, each a list of tuples."""
    width, height, _, kind = struct.unpack(">IIBB", png[16:26])
    channels = {2: 3, 6: 4}[kind]
    at, packed = 8, b""
    while at < len(png):
        size, name = struct.unpack(">I4s", png[at : at + 8])
        packed += png[at + 8 : at + 8 + size] if name == b"IDAT" else b""
        at += 12 + size
    data, stride = zlib.decompress(packed), width * channels
    rows, above = [], bytearray(stride)
    for y in range(height):
        method, row = data[y * (stride + 1)], bytearray(data[y * (stride + 1) + 1 : (y + 1) * (stride + 1)])
        for x in range(stride):
            left, up = (row[x - channels] if x >= channels else 0), above[x]
            corner = above[x - channels] if x >= channels else 0
            guess = left + up - corner
            nearest = min((left, up, corner), key=lambda value: abs(guess - value))
            row[x] = (row[x] + [0, left, up, (left + up) // 2, nearest][method]) & 255
        rows.append([tuple(row[x : x + channels]) for x in range(0, stride, channels)])
        above = row
    return rows


class Page:
    """The page in a browser."""

    def __init__(self, browser, address):
        self.browser, self.address = browser, address

    def open(self, **options):
        query = "&".join(f"{name}={value}" for name, value in options.items())
        self.browser.open(f"{self.address}?{query}")

    def status(self):
        return json.loads(self.browser.run("return globalThis.fnopt ? fnopt.page.status() : '{}'"))

    def message(self):
        return self.browser.run("return document.getElementById('message')?.textContent ?? ''")

    def ready(self):
        """Waits until a scene is there, which can be paused."""
        self.browser.wait(lambda: "frame" in self.status(), 60, "a scene")

    def reach(self, frame, seconds=60):
        """Waits for a frame, and returns the status then."""

        def reached():
            status = self.status()
            assert not status.get("fault"), status["fault"]
            return status if status.get("frame", -1) >= frame else None

        return self.browser.wait(reached, seconds, f"frame {frame}; {self.browser.run('return location.search')}")

    def steps(self, count):
        """Computes so many frames with the button."""
        last = self.status()["frame"]
        for k in range(count):
            self.browser.click("#step")
            status = self.reach(last + 1 + k)
        return status

    def begin(self, scene="default", playing=False, **options):
        """Begins a scene on the page that is open, which keeps its kernels, or on a new one."""
        if "frame" not in self.status():
            self.open(**QUICK, paused=1)
            self.ready()
        if (self.browser.text("#pause") == "Pause") != playing:
            self.browser.click("#pause")
        self.browser.run("history.replaceState(null, '', '?')")
        self.choose(**{**QUICK, **options, "scene": scene})
        loaded = lambda: f"scene={scene}&" in self.browser.run("return location.search")
        self.browser.wait(loaded, 30, f"{scene}; {self.message()}")

    def choose(self, **values):
        """Sets controls as a user does, all but the last one without telling the page."""
        self.browser.run(
            """const entries = Object.entries(arguments[0]);
            for (const [id, value] of entries) document.getElementById(id).value = value;
            document.getElementById(entries.at(-1)[0]).dispatchEvent(new Event("change"));
            await new Promise((done) => setTimeout(done, 60));""",
            values,
        )

    def quiet(self):
        """Fails if the console has errors."""
        wrong = [text for level, text in self.browser.log() if level == "SEVERE"]
        assert not wrong, wrong


def energies(page, report):
    """The first frames of the default scene have the energies of the CPU path."""
    frames = {frame["frame"]: frame["energy_total"] for frame in report["per_frame"]}
    page.begin(solver="fnopt", iterations=10, grid="")
    for frame, energy in frames.items():
        found = page.steps(1)
        assert found["frame"] == frame and abs(found["energy"] / energy - 1) < 1e-3, (frame, energy, found["energy"])
    return f"{len(frames)} frames"


def picture(page, _):
    """The canvas shows the cloth, in more colours than that of the page."""
    page.begin()
    page.steps(1)
    rows = pixels(page.browser.picture("#picture"))
    ground = rows[2][len(rows[0]) // 2]
    drawn = [pixel for row in rows for pixel in row if sum(abs(a - b) for a, b in zip(pixel, ground)) > 30]
    share = len(drawn) / (len(rows) * len(rows[0]))
    assert 0.02 < share < 0.6 and len(set(drawn)) > 20, (share, len(set(drawn)))
    return f"{100 * share:.0f} % of the canvas"


def pause_and_step(page, _):
    """Pause stops, and a step makes one frame, with the buttons and with the keys."""
    page.begin(playing=True)
    page.reach(2)
    page.browser.click("#pause")
    time.sleep(1)
    before = page.status()["frame"]
    time.sleep(0.7)
    assert page.status()["frame"] == before, "it goes on"
    assert page.steps(1)["frame"] == before + 1
    page.browser.keys("#picture", "s")
    page.reach(before + 2)
    time.sleep(0.7)
    assert page.status()["frame"] == before + 2, "more than one frame"
    page.browser.click("#reset")
    assert page.status()["frame"] == 0
    page.browser.keys("#picture", " ")
    page.reach(2)
    assert page.browser.text("#pause") == "Pause"


def every_scene(page, _):
    """Every scene loads and runs three frames; those that need a file are refused, with the file's name."""
    page.begin()
    page.browser.click("#repeat")  # one scene has no more than three
    scenes = json.loads(page.browser.run("return fnopt.page.scenes()"))
    refused = {scene["name"] for scene in scenes if scene["refused"]}
    assert refused == SCENES_REFUSED, refused
    assert all(".obj" in scene["refused"] or ".npy" in scene["refused"] for scene in scenes if scene["refused"])
    for scene in (scene for scene in scenes if not scene["refused"]):
        began = time.monotonic()
        page.begin(scene["name"], playing=True)
        status = page.reach(3)
        values = [status["energy"], status["gradient"], status["lowest_m"], status["stretch"]]
        assert all(math.isfinite(value) for value in values) and page.message() == "", (scene["name"], values)
        if time.monotonic() - began > 5:
            print(f"  {scene['name']}: {time.monotonic() - began:.1f} s")
    page.browser.run("await fnopt.load({ scene: 'recorded' })")
    assert "xyz_v3.npy" in page.message(), page.message()
    return f"{len(scenes) - len(refused)} scenes"


def stiffness(page, _):
    """A softer cloth sags more, and the slider and its text say so."""
    page.begin()
    stiff = page.steps(8)["lowest_m"]
    page.browser.click("#reset")
    page.browser.keys("#stretch", "\ue011")  # Home
    assert "10 N/m" == page.browser.run("return document.querySelector('#stretch').getAttribute('aria-valuetext')")
    soft = page.steps(8)["lowest_m"]
    assert soft < stiff - 0.02, (stiff, soft)
    return f"{100 * (stiff - soft):.0f} cm lower"


def dragging(page, _):
    """A dragged handle moves its particle to where the pointer let it go; elsewhere the pointer turns the picture."""
    page.begin()
    left, top, width, height = page.browser.run(
        "const box = document.getElementById('picture').getBoundingClientRect(); return [box.left, box.top, box.width, box.height];"
    )
    at = lambda place: (left + width * place[0], top + height * place[1])
    handle = page.status()["handles"][0]
    goal = [handle["place"][0] - 0.1, handle["place"][1] + 0.15]
    page.browser.drag(at(handle["place"]), at(goal))
    after = page.steps(8)["handles"][0]
    moved = math.dist(handle["at_m"], after["at_m"])
    missed = math.dist(after["place"], goal)
    assert moved > 0.1 and missed < 0.01 and math.dist(after["at_m"], after["target_m"]) < 1e-3, (moved, missed, after)
    page.browser.drag(at([0.05, 0.9]), at([0.3, 0.9]))
    turned = page.status()["handles"][0]
    assert turned["at_m"] == after["at_m"] and math.dist(turned["place"], after["place"]) > 0.02, (after, turned)
    # The next handle, with the keys: Shift, and twice to the left.
    page.browser.keys("#picture", "h\ue008\ue012\ue012\ue000")
    other = page.status()["handles"][1]
    keyed = page.steps(3)["handles"][1]
    assert math.dist(keyed["at_m"], other["at_m"]) > 0.02, (other, keyed)
    # The cloth itself, which has no handle there and is free again afterwards.
    page.begin()
    free = page.steps(1)
    middle = [sum(side) / 2 for side in zip(*(handle["place"] for handle in free["handles"]))]
    grab = "fnopt.page.grab(...arguments); return JSON.parse(fnopt.page.status()).handles.at(-1)"
    where = page.browser.run(grab, middle[0], middle[1] + 0.25)
    page.browser.run("fnopt.page.drag(...arguments)", *middle)
    pulled = page.steps(3)["handles"]
    assert len(pulled) == len(free["handles"]) + 1 and pulled[-1]["particle"] == where["particle"], (where, pulled)
    assert pulled[-1]["at_m"][2] > where["at_m"][2] + 0.05, (where, pulled)
    page.browser.run("fnopt.page.release()")
    assert len(page.steps(1)["handles"]) == len(free["handles"])
    return f"{100 * moved:.0f} cm"


def mistakes(page, _):
    """What cannot be done is said, and the page goes on."""
    page.open(scene="spere", **QUICK)
    page.browser.wait(lambda: "did you mean sphere" in page.message(), 30, f"a message, not {page.message()}")
    page.choose(iterations=0, scene="sphere")
    page.browser.wait(lambda: "1 to 500" in page.message(), 10, f"a message, not {page.message()}")
    page.choose(iterations=3, grid=7)
    page.browser.wait(lambda: "8 to 256" in page.message(), 10, f"a message, not {page.message()}")
    page.choose(grid=12)
    page.reach(1)
    assert page.message() == ""
    wrong = page.browser.run("try { fnopt.page.set('strech', 1) } catch (error) { return error.message }")
    assert "did you mean stretch" in wrong, wrong


def not_finite(page, _):
    """A cloth that diverges stops the page with a message, and Reset begins again."""
    page.begin(playing=True)
    page.browser.run("await fnopt.load({ scene: 'default', solver: 'gd', iterations: 20, grid: 12 }); fnopt.page.set('stretch', 1e6);")
    page.browser.wait(lambda: "non-finite" in page.message(), 60, f"a message, not {page.message()}")
    assert page.status()["fault"]["kind"] == "non-finite" and page.browser.text("#pause") == "Play"
    page.browser.click("#reset")
    assert page.message() == "" and page.status()["fault"] is None
    page.begin("wind")
    assert page.steps(1)["frame"] == 1


def labels(page, _):
    """Every control has a name, and on a phone's width nothing is cut off, in light and dark."""
    nameless = page.browser.run(
        """return [...document.querySelectorAll("input, select, button, canvas")]
            .filter((e) => !(e.labels?.length || e.textContent.trim() || e.getAttribute("aria-label"))).map((e) => e.outerHTML);"""
    )
    assert not nameless, nameless
    grounds = set()
    metrics = {"width": 375, "height": 740, "deviceScaleFactor": 1, "mobile": True}
    page.browser.devtools("Emulation.setDeviceMetricsOverride", metrics)
    for scheme in ["light", "dark"]:
        page.browser.devtools("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
        wide, ground = page.browser.run("return [document.documentElement.scrollWidth, getComputedStyle(document.body).backgroundColor]")
        assert wide <= 375, f"{wide} pixels"
        grounds.add(ground)
    assert len(grounds) == 2, grounds
    page.browser.devtools("Emulation.clearDeviceMetricsOverride", {})


def without_webgpu(page, _):
    """A browser without WebGPU is told so, and so is one that opens no device."""
    for script, said in [
        ("Object.defineProperty(Navigator.prototype, 'gpu', { get: () => undefined });", "has no WebGPU"),
        ("GPU.prototype.requestAdapter = async () => null;", "no device could be opened"),
    ]:
        identifier = page.browser.before_pages(script)
        page.open()
        page.browser.wait(lambda: said in page.message(), 20, f"'{said}', not {page.message()}")
        page.browser.forget(identifier)


def lost(page, _):
    """The loss of the device is told."""
    page.begin(playing=True)
    page.reach(1)
    page.browser.run("device.destroy()")
    page.browser.wait(lambda: "device was lost" in page.message(), 20, f"a message, not {page.message()}")


# In one page as far as possible, since compiling the kernels takes longest.
CHECKS = [mistakes, picture, pause_and_step, stiffness, dragging, every_scene, energies, not_finite, labels]
# Those in which the console rightly has errors.
FAULTS = [lost, without_webgpu]
# Keeps the device where `lost` finds it.
KEEP_DEVICE = """const open = GPUAdapter.prototype.requestDevice;
GPUAdapter.prototype.requestDevice = async function (...all) { return (globalThis.device = await open.apply(this, all)); };"""


def main():
    folder, report = pathlib.Path(sys.argv[1]), json.loads(pathlib.Path(sys.argv[2]).read_text())
    wanted, failed = sys.argv[3:], []
    with served(folder) as address, tempfile.TemporaryDirectory() as profile, Browser(profile, (900, 700)) as browser:
        browser.before_pages(KEEP_DEVICE)
        page = Page(browser, address)
        for check in CHECKS + FAULTS:
            if wanted and check.__name__ not in wanted:
                continue
            began = time.monotonic()
            try:
                found = check(page, report)
                if check in CHECKS:
                    page.quiet()
                else:
                    browser.log()
                result = found or "done"
            except (AssertionError, TimeoutError, OSError, KeyError) as error:
                failed.append(check.__name__)
                result = f"FAILED: {type(error).__name__}: {error}; the page says {page.message()!r}"
            print(f"{check.__name__}: {result} ({time.monotonic() - began:.1f} s)", flush=True)
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


main()
