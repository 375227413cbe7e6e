"""Headless Chromium through ChromeDriver, by WebDriver's own protocol: HTTP and JSON."""

import base64
import json
import re
import shutil
import subprocess
import time
import urllib.error
import urllib.request

# SwiftShader, so that no graphics card is needed; without the connections that a new browser makes of its own.
OPTIONS = """
--headless=new --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update --disable-sync
--enable-unsafe-webgpu --enable-features=Vulkan --use-webgpu-adapter=swiftshader --use-vulkan=swiftshader --use-gl=angle
--use-angle=swiftshader
""".split()
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"


class Browser:
    """A browser with one page, as a context: it ends with it."""

    def __init__(self, profile, size=(1280, 900)):
        options = [*OPTIONS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        self.driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for line in self.driver.stdout:
            if found := re.search(r"started successfully on port (\d+)", line):
                self.address = f"http://127.0.0.1:{found[1]}/session"
                break
        else:
            raise OSError("chromedriver did not start")
        chrome = {"binary": shutil.which("chromium"), "args": options}
        wanted = {"goog:chromeOptions": chrome, "goog:loggingPrefs": {"browser": "ALL"}}
        found = self.call("POST", "", {"capabilities": {"alwaysMatch": wanted}})
        self.address += "/" + found["sessionId"]
        self.call("POST", "/timeouts", {"script": 60_000, "pageLoad": 60_000})

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.call("DELETE", "")
        except OSError:
            pass
        self.driver.terminate()
        self.driver.wait()

    def call(self, method, path, body=None):
        """Sends a command and returns its value."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise OSError(f"{method} {path}: {json.load(error)['value']['message']}") from None

    def open(self, address):
        self.call("POST", "/url", {"url": address})

    def run(self, script, *arguments):
        """Runs the body of a function in the page and returns what it returns; it may await."""
        script = f"const done = arguments[arguments.length - 1]; (async (...arguments) => {{ {script} }})(...arguments).then(done, (e) => done({{ failed: String(e) }}))"
        value = self.call("POST", "/execute/async", {"script": script, "args": list(arguments)})
        if isinstance(value, dict) and "failed" in value:
            raise OSError(value["failed"])
        return value

    def before_pages(self, script):
        """Runs a script in every page before its own; returns what `forget` takes."""
        return self.devtools("Page.addScriptToEvaluateOnNewDocument", {"source": script})["identifier"]

    def forget(self, identifier):
        self.devtools("Page.removeScriptToEvaluateOnNewDocument", {"identifier": identifier})

    def devtools(self, command, parameters):
        """Sends a command of Chromium's own protocol."""
        return self.call("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def find(self, selector):
        return self.call("POST", "/element", {"using": "css selector", "value": selector})[ELEMENT]

    def text(self, selector):
        return self.call("GET", f"/element/{self.find(selector)}/text")

    def click(self, selector):
        self.call("POST", f"/element/{self.find(selector)}/click", {})

    def keys(self, selector, text):
        self.call("POST", f"/element/{self.find(selector)}/value", {"text": text})

    def picture(self, selector):
        """Returns a PNG of an element."""
        return base64.b64decode(self.call("GET", f"/element/{self.find(selector)}/screenshot"))

    def drag(self, *places):
        """Presses the mouse at the first of these places in the window, moves it through the others, and lets it go."""
        move = [{"type": "pointerMove", "duration": 60, "x": round(x), "y": round(y)} for x, y in places]
        press, release = {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}
        actions = [{"type": "pointer", "id": "mouse", "actions": [move[0], press, *move[1:], release]}]
        self.call("POST", "/actions", {"actions": actions})

    def log(self):
        """Returns what the console has said since the last call: (level, text)."""
        return [(line["level"], line["message"]) for line in self.call("POST", "/se/log", {"type": "browser"})]

    def wait(self, condition, seconds, what):
        """Returns the value of `condition` as soon as it is true."""
        end = time.monotonic() + seconds
        while not (value := condition()):
            if time.monotonic() > end:
                raise TimeoutError(f"not within {seconds} s: {what}")
            time.sleep(0.05)
        return value
