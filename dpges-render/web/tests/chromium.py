"""Chromium without a window, driven through a pipe with the DevTools protocol; no packages needed."""

import base64
import itertools
import json
import os
import pathlib
import select
import shutil
import subprocess
import tempfile
import time

# WebGPU and WebGL2 on SwiftShader, which runs on the processor; no traffic of the browser's own.
FLAGS = """--no-sandbox --enable-unsafe-webgpu --enable-unsafe-swiftshader --use-angle=swiftshader
--enable-features=Vulkan --use-vulkan=swiftshader --ignore-gpu-blocklist --enable-gpu --disable-quic --no-first-run
--disable-background-networking --disable-component-update --disable-sync --disable-dev-shm-usage
--remote-debugging-pipe --hide-scrollbars""".split()

DRIVER = "vk_swiftshader_icd.json"
# Where distributions install what a script in PATH starts.
INSTALLED = ("/usr/lib/chromium", "/usr/lib/chromium-browser", "/opt/google/chrome")


def program():
    """The path of the browser."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        raise SystemExit("missing: chromium (on Debian: apt-get install chromium)")
    return found


def vulkan_driver():
    """The description of the Vulkan driver that comes with the browser, SwiftShader."""
    folders = [pathlib.Path(program()).resolve().parent, *map(pathlib.Path, INSTALLED)]
    found = next((folder / DRIVER for folder in folders if (folder / DRIVER).is_file()), None)
    if found is None:
        raise SystemExit(f"missing: {DRIVER}, which should be in one of {', '.join(map(str, folders))}")
    return found


class Chromium:
    """One tab. `with Chromium() as tab: tab.open(url); tab.evaluate("1 + 1")`"""

    def __init__(self, width=1280, height=720, window=False):
        self.profile = tempfile.TemporaryDirectory(prefix="dpges-web-", ignore_cleanup_errors=True)
        to_browser, self.write_end = os.pipe()
        self.read_end, from_browser = os.pipe()
        mode = [] if window else ["--headless=new"]
        # The browser reads commands from descriptor 3 and writes answers to descriptor 4.
        command = [program(), *mode, *FLAGS, f"--window-size={width},{height}", f"--user-data-dir={self.profile.name}"]
        script = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        self.process = subprocess.Popen(
            ["bash", "-c", script, "bash", *command, "about:blank"],
            pass_fds=(to_browser, from_browser), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self.numbers = itertools.count(1)
        self.buffer = b""
        self.log = []
        self.session = None
        targets = self.call("Target.getTargets")["targetInfos"]
        tab = next(target for target in targets if target["type"] == "page")
        self.session = self.call("Target.attachToTarget", targetId=tab["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime"):
            self.call(f"{domain}.enable")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.session = None
            self.call("Browser.close", timeout=10)
            self.process.wait(10)
        except (OSError, RuntimeError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        os.close(self.write_end)
        os.close(self.read_end)
        self.profile.cleanup()

    def call(self, method, timeout=120, **parameters):
        """The result of a command of the protocol."""
        number = next(self.numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.write_end, data):]
        until = time.monotonic() + timeout
        while True:
            answer = self.next_message(until, method)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            if answer.get("method") == "Runtime.consoleAPICalled":
                values = answer["params"]["args"]
                self.log.append(" ".join(str(value.get("value", value.get("description"))) for value in values))

    def next_message(self, until, method):
        while b"\0" not in self.buffer:
            ready, _, _ = select.select([self.read_end], [], [], max(until - time.monotonic(), 0))
            part = os.read(self.read_end, 1 << 20) if ready else b""
            if not part:
                raise RuntimeError(f"the browser gave no answer to {method}")
            self.buffer += part
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def evaluate(self, expression, timeout=120):
        """The value of a JavaScript expression; a promise is awaited."""
        result = self.call("Runtime.evaluate", timeout=timeout, expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in result:
            details = result["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description", details["text"]))
        return result["result"].get("value")

    def open(self, url, timeout=120):
        """Opens a page of the viewer and waits until it shows a scene, asks for one, or says what is wrong."""
        self.log.clear()
        self.call("Page.navigate", url=url)
        until = time.monotonic() + timeout
        while time.monotonic() < until:
            state = self.evaluate("document.readyState === 'complete' ? document.documentElement.dataset.state : null")
            if state in ("shown", "empty", "failed"):
                return state
            time.sleep(0.05)
        raise RuntimeError(f"{url} is still loading after {timeout} s; console: {self.log}")

    def screenshot(self, path):
        with open(path, "wb") as file:
            file.write(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
