"""A page in a real browser without a window."""

import json
import re
import shutil
import subprocess
import tempfile
from html import unescape
from pathlib import Path

import pytest

BROWSER = next((name for name in ("chromium", "chromium-browser", "google-chrome") if shutil.which(name)), None)
LIGHT, DARK = "preferredColorScheme=1", "preferredColorScheme=0"

_HEAD = """<script>
window.problems = [];
for (const kind of ["error", "unhandledrejection"])
  addEventListener(kind, (event) => problems.push(String(event.message || event.reason)));
console.error = console.warn = (...words) => problems.push(words.join(" "));
</script>"""
_END = """<script>
(async () => {
  const answer = await (async () => { SCRIPT })().catch((error) => ({ failed: String(error) }));
  const result = document.createElement("pre");
  result.id = "result";
  result.textContent = JSON.stringify({ answer, problems });
  document.body.append(result);
})();
</script>"""


def run(page, script, scheme=LIGHT):
    """What a script returns that runs at the end of a page (HTML), and all errors and warnings of the console."""
    if BROWSER is None:
        pytest.skip("no chromium or chrome on this machine")
    text = page.replace("<head>", "<head>" + _HEAD, 1).replace("</body>", _END.replace("SCRIPT", script) + "</body>", 1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "page.html"
        file.write_text(text, encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}/profile", "--dump-dom"]
        settings = [f"--blink-settings={scheme}", "--virtual-time-budget=20000", "--window-size=1700,1000"]
        command = [BROWSER, *options, *settings, file.as_uri()]
        answer = subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8")
    found = re.search(r'<pre id="result">(.*?)</pre>', answer.stdout, re.DOTALL)
    assert found, f"the page gave no result: {answer.stderr[-2000:]}"
    result = json.loads(unescape(found.group(1)))
    return result["answer"], result["problems"]
