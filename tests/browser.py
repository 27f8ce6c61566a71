"""A page in a real headless Chromium: what it logs, whether its pictures load, how wide it is, and what its canvas
shows after input."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=4000",
)

# Put into a copy of the page before anything else in it.
_LISTEN = """<script>
window.heard = [];
for (const kind of ["error", "unhandledrejection", "securitypolicyviolation"])
  window.addEventListener(kind, (event) => heard.push([kind, event.message, event.reason, event.blockedURI].join(" ")));
</script>"""

# ... and at its end: drags, presses and clicks, and tells the page around it what it saw.
_PROBE = """<script>
(async () => {
  const pause = () => new Promise((done) => setTimeout(done, 100));
  const canvas = document.querySelector("canvas");
  const shown = async () => { await pause(); return canvas.toDataURL(); };
  const pointer = (kind, x, y, id = 1) => canvas.dispatchEvent(
    new PointerEvent(kind, { clientX: x, clientY: y, pointerId: id, bubbles: true }));
  const press = (key) => canvas.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  const steps = {};
  if (canvas) {
    steps.start = await shown();
    pointer("pointerdown", 100, 100); pointer("pointermove", 160, 130); pointer("pointerup", 160, 130);
    steps.dragged = await shown();
    press("0");
    steps.reset = await shown();
    press("ArrowLeft");
    steps.key = await shown();
    press("0"); press("+");
    steps.zoomed = await shown();
    press("0");
    pointer("pointerdown", 100, 100, 1); pointer("pointerdown", 200, 100, 2);
    pointer("pointermove", 260, 100, 2); pointer("pointerup", 260, 100, 2); pointer("pointerup", 100, 100, 1);
    steps.pinched = await shown();
    press("0");
    document.querySelector("input[data-layer-of]").click();
    steps.layer_off = await shown();
  }
  const pixels = canvas && canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const images = [...document.images];
  const report = {
    heard, steps,
    images: images.length,
    missing: images.filter((image) => !(image.complete && image.naturalWidth > 0)).map((image) => image.alt),
    window_px: window.innerWidth,
    overflow_px: document.documentElement.scrollWidth - document.documentElement.clientWidth,
    drawn: pixels ? pixels.some((value) => value > 0) : false,
  };
  parent.postMessage(JSON.stringify(report), "*");
})();
</script>"""

# The page stands in a frame, since a browser's own window has a least width.
_FRAME = """<!doctype html><body><pre id="probe"></pre><script>
window.addEventListener("message", (event) => { document.getElementById("probe").textContent = event.data; });
</script><iframe src="probed.html" style="border:0" width="WIDTH_PX" height="900"></iframe></body>"""


@dataclass(frozen=True)
class Seen:
    """What the browser saw. ``steps``: the canvas as a data URI after each input. ``console``: lines logged.
    ``overflow_px``: how much wider the page is than the window."""

    heard: list[str]
    console: list[str]
    steps: dict[str, str]
    images: int
    missing: list[str]
    window_px: int
    overflow_px: int
    drawn: bool


def _source(script: str) -> str:
    """How a Content-Security-Policy names an element by what is in it."""
    content = script.removeprefix("<script>").removesuffix("</script>")
    return f"sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}"


def _chromium() -> str:
    """The test is skipped where there is none."""
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        pytest.skip(f"no Chromium is installed (none of {', '.join(_NAMES)} is on the path)")
    return found


def n_pages_on_paper(page: Path, tmp_path: Path) -> int:
    """How many pages of paper it takes. The test is skipped where there is no Chromium."""
    target = tmp_path / "paper.pdf"
    flags = (*_FLAGS, f"--user-data-dir={tmp_path / 'profile'}", f"--print-to-pdf={target}")
    subprocess.run([_chromium(), *flags, page.as_uri()], capture_output=True, timeout=120, check=True)
    return len(re.findall(rb"/Type /Page\b(?!s)", target.read_bytes()))


def look_at(page: Path, tmp_path: Path, *, width_px: int) -> Seen:
    """Open a page in a window of this width. The test is skipped where there is no Chromium."""
    chromium = _chromium()
    text = page.read_text(encoding="utf-8")
    # the page's own policy stays, and lets what is put in act too
    probed = text.replace("script-src ", f"script-src '{_source(_PROBE)}' ", 1)
    probed = probed.replace("<head>", f"<head>{_LISTEN}", 1).replace("</body>", f"{_PROBE}</body>", 1)
    (tmp_path / "probed.html").write_text(probed, encoding="utf-8")
    outer = tmp_path / "frame.html"
    outer.write_text(_FRAME.replace("WIDTH_PX", str(width_px)), encoding="utf-8")
    profile = tmp_path / "profile"
    done = subprocess.run(
        [chromium, *_FLAGS, f"--user-data-dir={profile}", "--window-size=1600,1000", "--dump-dom", outer.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None, done.stderr
    assert found[1], "the page reported nothing"
    report: dict[str, Any] = json.loads(html.unescape(found[1]))
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return Seen(console=console, **report)
