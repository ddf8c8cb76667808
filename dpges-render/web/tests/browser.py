#!/usr/bin/env python3
"""The browser viewer in headless Chromium: pictures against the native renderer's, faults, and behaviour.

    browser.py              builds the page, exports a made scene, tests WebGPU and WebGL2
    browser.py --folder F   tests the folder F that an earlier run left with --keep F
"""

import argparse
import base64
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
import time

from chromium import Chromium, vulkan_driver
from site_with_faults import Site

WEB = pathlib.Path(__file__).resolve().parent.parent
BACKENDS = {"webgpu": "WebGPU", "webgl": "WebGL2"}
# Least PSNR between the browser's picture and the native one, dB, by the bits of the browser's sums: native ones have 32.
# Both are drawn by SwiftShader: drivers differ in how finely they place the corners of triangles.
LEAST_PSNR = {32: 70.0, 16: 40.0}
# No frame is asked for in so long once nothing moves, ms.
QUIET_MS = 300
PATIENCE_S = 60

READ = """
(async () => {
  const { page } = await import("./viewer.js");
  const image = await page.picture(%s, %s);
  let text = "";
  for (let at = 0; at < image.data.length; at += 8192) text += String.fromCharCode(...image.data.subarray(at, at + 8192));
  return btoa(text);
})()
"""
# Counts the frames that the page has asked for: all, and those that the browser has yet to draw.
COUNT = """
window.frames = { asked: 0, waiting: 0 };
const request = window.requestAnimationFrame;
window.requestAnimationFrame = (callback) => {
  frames.asked += 1;
  frames.waiting += 1;
  return request((now) => { frames.waiting -= 1; callback(now); });
};
"""
# Drops the scene on the page as a file.
DROP = """
(async () => {
  document.documentElement.dataset.state = "waits";
  const transfer = new DataTransfer();
  transfer.items.add(new File([await (await fetch("scene.safetensors")).blob()], "dropped.safetensors"));
  dispatchEvent(new DragEvent("drop", { dataTransfer: transfer }));
})()
"""
EYE = """(async () => Array.from((await import("./viewer.js")).page.viewer.eye()))()"""
OPTIONS = """(async () => (await import("./viewer.js")).page.options())()"""
DEVICE = """(async () => (await import("./viewer.js")).page.viewer.device())()"""
COMPLETE = """(async () => JSON.parse((await import("./viewer.js")).page.viewer.levels()).complete)()"""
PLAY = """document.getElementById("play").textContent"""
STATUS = """document.getElementById("status").textContent"""
TEXT = """document.getElementById("message-text").textContent"""
WAIT = "new Promise((resolve) => setTimeout(resolve, %d))"

failures = []


def check(name, passed, found=""):
    print(f"{'ok    ' if passed else 'FAILED'}  {name}{f': {found}' if found != '' else ''}", flush=True)
    if not passed:
        failures.append(name)


def prepare(folder, scene):
    """Builds the page and exports `scene`, or a made one, to `folder`, with native pictures of it."""
    subprocess.run([WEB / "build.sh"], check=True)
    command = "cargo test --package dpges-render --features export,viewer --test browser_fixture -- --ignored --nocapture"
    driver = str(vulkan_driver())
    environment = {**os.environ, "DPGES_WEB_FIXTURE": str(folder), "VK_DRIVER_FILES": driver, "VK_ICD_FILENAMES": driver}
    if scene:
        environment["DPGES_WEB_SCENE"] = str(scene.resolve())
    subprocess.run(command.split(), check=True, cwd=WEB.parent.parent, env=environment)


def read_ppm(path):
    kind, width, height, largest, pixels = path.read_bytes().split(maxsplit=4)
    assert (kind, largest) == (b"P6", b"255")
    width, height = int(width), int(height)
    assert len(pixels) == 3 * width * height
    return pixels


def psnr(a, b):
    squares = sum((x - y) * (x - y) for x, y in zip(a, b, strict=True))
    return math.inf if squares == 0 else 10 * math.log10(255 * 255 * len(a) / squares)


def pictures(tab, site, folder, backend, save):
    """Every picture of `reference.json` is what the native renderer made."""
    label, scene = BACKENDS[backend], None
    for reference in json.loads((folder / "reference.json").read_text()):
        name, camera, options = reference["name"], json.dumps(reference["camera"]), json.dumps(reference["options"])
        if reference["scene"] != scene:
            scene = reference["scene"]
            state = tab.open(f"{site.here}/?backend={backend}&url={scene}")
            check(f"{label}: {scene} is shown", state == "shown", tab.evaluate(TEXT))
        if scene.endswith(".json"):
            check(f"{label}: all of {scene} comes", wait_until(tab, COMPLETE), tab.evaluate(STATUS))
        least = LEAST_PSNR[json.loads(tab.evaluate(DEVICE))["precision_bits"]]
        found = base64.b64decode(tab.evaluate(READ % (camera, options)))
        opaque = all(alpha == 255 for alpha in found[3::4])
        rgb = bytes(byte for at, byte in enumerate(found) if at % 4 != 3)
        if save:
            size = f"{reference['camera']['width']} {reference['camera']['height']}"
            save.mkdir(parents=True, exist_ok=True)
            (save / f"{name}_{backend}.ppm").write_bytes(f"P6 {size} 255\n".encode() + rgb)
        expected = read_ppm(folder / f"{name}.ppm")
        several = name == "nothing" or len(set(zip(expected[::3], expected[1::3], expected[2::3]))) > 8
        found_psnr = psnr(rgb, expected)
        check(f"{label}: {name}", several and opaque and found_psnr >= least, f"{found_psnr:.2f} dB, at least {least:.0f}")


def exported(tab, folder, label):
    """The page is what was exported: it starts at the first camera and had a poster."""
    device = json.loads(tab.evaluate(DEVICE))
    check(f"{label}: draws the exported scene", device["backend"] == label, json.dumps(device))
    position = json.loads((folder / "reference.json").read_text())[0]["camera"]["position"]
    distance = math.dist(tab.evaluate(EYE), position)
    check(f"{label}: starts at the first camera", distance < 1e-9, distance)
    poster = tab.evaluate("[document.getElementById('poster').naturalWidth, document.getElementById('poster').hidden]")
    check(f"{label}: had a poster", poster == [640, True], poster)
    try:
        camera = json.loads((folder / "reference.json").read_text())[0]["camera"]
        tab.evaluate(READ % (json.dumps(camera), json.dumps({**tab.evaluate(OPTIONS), "layer_count": 9})))
        check(f"{label}: nine layers are refused", False)
    except RuntimeError as error:
        check(f"{label}: nine layers are refused", "`layer_count` is 9" in str(error), str(error).splitlines()[0])


def wait_until(tab, expression):
    """Whether a JavaScript expression becomes true within a time that no computer needs."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        if tab.evaluate(expression):
            return True
        tab.evaluate(WAIT % 50)
    return False


def rests(tab):
    """Whether there comes a time in which no frame is asked for."""
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until:
        asked, waiting = tab.evaluate("[frames.asked, frames.waiting]")
        tab.evaluate(WAIT % QUIET_MS)
        if waiting == 0 and tab.evaluate("frames.asked") == asked:
            return True
    return False


def moved(before):
    return f"(async () => !!((await {EYE}).some((x, i) => x !== {json.dumps(before)}[i])))()"


def behaviour(tab, label):
    """Frames are drawn when something changes, and only then."""
    check(f"{label}: at rest nothing is drawn", rests(tab))
    before, asked = tab.evaluate(EYE), tab.evaluate("frames.asked")

    def mouse(kind, x):
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=300, button="left", buttons=1, clickCount=1)

    mouse("mousePressed", 400)
    for step in range(1, 6):
        mouse("mouseMoved", 400 + 20 * step)
    mouse("mouseReleased", 500)
    turned = wait_until(tab, moved(before)) and tab.evaluate("frames.asked") > asked
    check(f"{label}: a drag turns the scene", turned)
    check(f"{label}: it comes to rest", rests(tab))

    before = tab.evaluate(EYE)

    def fingers(kind, *places):
        points = [{"x": x, "y": 300, "id": number} for number, x in enumerate(places)]
        tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    fingers("touchStart", 300, 500)
    for step in range(1, 6):
        fingers("touchMove", 300 - 10 * step, 500 + 10 * step)
    fingers("touchEnd")
    check(f"{label}: two fingers zoom", wait_until(tab, moved(before)))
    check(f"{label}: it comes to rest", rests(tab))

    before = tab.evaluate(EYE)
    tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=640, y=360, deltaX=0, deltaY=-200)
    check(f"{label}: the wheel approaches", wait_until(tab, moved(before)) and rests(tab))
    before = tab.evaluate(EYE)
    for clicks in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            tab.call("Input.dispatchMouseEvent", type=kind, x=500, y=360, button="left", buttons=1, clickCount=clicks)
    check(f"{label}: a double click sets the focus", wait_until(tab, moved(before)) and rests(tab))

    def key(code, name, number):
        for kind in ("keyDown", "keyUp"):
            tab.call("Input.dispatchKeyEvent", type=kind, code=code, key=name, windowsVirtualKeyCode=number)

    tab.call("Input.dispatchKeyEvent", type="keyDown", code="KeyW", key="w", windowsVirtualKeyCode=87)
    before = tab.evaluate(EYE)
    check(f"{label}: W flies", wait_until(tab, moved(before)))
    tab.call("Input.dispatchKeyEvent", type="keyUp", code="KeyW", key="w", windowsVirtualKeyCode=87)
    check(f"{label}: it comes to rest", rests(tab))

    names = tab.evaluate("[...document.getElementById('views').options].map((option) => option.text)")
    check(f"{label}: the views are listed", names == ["Views", "front", "from the left"], names)
    before = tab.evaluate(EYE)
    key("PageDown", "PageDown", 34)
    flown = wait_until(tab, moved(before)) and rests(tab)
    check(f"{label}: page down flies to the next view", flown and tab.evaluate("document.getElementById('views').value") == "1")
    before = tab.evaluate(EYE)
    key("Space", " ", 32)
    check(f"{label}: the camera path plays", wait_until(tab, moved(before)) and tab.evaluate(PLAY) == "Stop", tab.evaluate(PLAY))
    tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=640, y=360, deltaX=0, deltaY=100)
    check(f"{label}: hands end it", wait_until(tab, f"{PLAY} === 'Play'") and rests(tab))
    key("Digit2", "2", 50)
    check(f"{label}: a key shows the surfels", wait_until(tab, "document.getElementById('settings').display.value === 'surfels'"))
    check(f"{label}: no message", tab.evaluate("document.getElementById('message').hidden"), tab.evaluate(TEXT))


def single(tab, folder, save):
    """One file opens from a disk, also on the screen of a phone, where fingers find the buttons."""
    tab.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
    state = tab.open((folder / "single.html").resolve().as_uri())
    check("one file from a disk is shown", state == "shown", tab.evaluate(TEXT))
    sides = tab.evaluate("""[...document.querySelectorAll("#bar > :not([hidden])")].flatMap((button) => {
        const { width, height, left, right } = button.getBoundingClientRect();
        return [width, height, left >= 0 && right <= innerWidth ? 44 : 0];
    })""")
    check("buttons are as large as a finger", len(sides) == 18 and min(sides) >= 44, sides)
    loaded = tab.evaluate("performance.getEntriesByType('resource').map((entry) => entry.name.slice(0, 8))")
    check("it needs no other file", all(name.startswith(("data:", "blob:")) for name in loaded), loaded)
    if save:
        save.mkdir(parents=True, exist_ok=True)
        tab.screenshot(save / "single.png")
    tab.evaluate("document.getElementById('play').click()")
    check("it plays the path", wait_until(tab, f"{PLAY} === 'Stop'"))
    state = tab.open((folder / "single.html").resolve().as_uri() + "?view=nowhere")
    check("a view that is not there is said", state == "shown" and 'No view is called "nowhere"' in tab.evaluate(TEXT), tab.evaluate(TEXT))


def faults(tab, site):
    """What is wrong is said, and what to do."""
    page = f"{site.here}/?url="
    cases = {
        "a file that is not there": (f"{site.here}/absent.safetensors", "is not there (404)"),
        "half a file": (f"{site.here}/half/scene.safetensors", "ended after"),
        "a foreign file": (f"{site.here}/foreign/scene.safetensors", "not a safetensors file"),
        "a web page": (f"{site.here}/page/scene.safetensors", "It is a web page"),
        "another site without CORS": (f"{site.elsewhere}/scene.safetensors", "Access-Control-Allow-Origin"),
        "an address that is no web address": ("javascript:alert(1)", "not an address of the web"),
    }
    for name, (url, expected) in cases.items():
        state, text = tab.open(page + url), tab.evaluate(TEXT)
        check(name, state == "failed" and expected in text, text)
    state, text = tab.open(f"{page}{site.here}/ignores/levels/index.json"), tab.evaluate(TEXT)
    check("a server without ranges", state == "failed" and "ignores ranges" in text, text)
    state = tab.open(f"{page}{site.here}/torn/levels/index.json")
    said = wait_until(tab, f"{STATUS}.includes('2 parts could not be loaded and stay coarse')")
    check("cells that do not come leave the coarsest level", state == "shown" and said, tab.evaluate(STATUS))
    state = tab.open(f"{page}{site.here}/levels/index.json&budget=10")
    check("a budget that is too small", "at least 450" in tab.evaluate(TEXT), tab.evaluate(TEXT))
    state = tab.open(f"{site.here}/?url={site.here}/slow/scene.safetensors")
    check("a file of unknown length", state == "shown", state)
    tab.evaluate(DROP)
    check("a dropped file", wait_until(tab, "document.documentElement.dataset.state === 'shown'"), tab.evaluate(TEXT))
    tab.call("Page.addScriptToEvaluateOnNewDocument", source="""
        Object.defineProperty(navigator, "gpu", { value: undefined });
        HTMLCanvasElement.prototype.getContext = () => null;
    """)
    state, text = tab.open(f"{site.here}/"), tab.evaluate(TEXT)
    check("neither WebGPU nor WebGL2", state == "failed" and "needs WebGPU or WebGL2" in text, text)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--folder", type=pathlib.Path, help="an exported folder with references; nothing is built")
    arguments.add_argument("--keep", type=pathlib.Path, help="where to export to, in place of a temporary folder")
    arguments.add_argument("--scene", type=pathlib.Path, help="a scene file in place of a made scene")
    arguments.add_argument("--backends", nargs="+", choices=BACKENDS, default=list(BACKENDS))
    arguments.add_argument("--save", type=pathlib.Path, help="where to write the browser's pictures")
    chosen = arguments.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.folder or chosen.keep or pathlib.Path(temporary)
        if chosen.folder is None:
            prepare(folder.resolve(), chosen.scene)
        with Site(folder) as site:
            for backend in chosen.backends:
                with Chromium() as tab:
                    tab.call("Page.addScriptToEvaluateOnNewDocument", source=COUNT)
                    state = tab.open(f"{site.here}/?backend={backend}")
                    label = BACKENDS[backend]
                    if state != "shown":
                        check(f"{label}: draws the exported scene", False, f"{state}: {tab.evaluate(TEXT)} {tab.log}")
                        continue
                    exported(tab, folder, label)
                    behaviour(tab, label)
                    pictures(tab, site, folder, backend, chosen.save)
            with Chromium() as tab:
                single(tab, folder, chosen.save)
            with Chromium() as tab:
                faults(tab, site)
    if failures:
        sys.exit(f"{len(failures)} failed: {', '.join(failures)}")
    print("all passed")


if __name__ == "__main__":
    main()
