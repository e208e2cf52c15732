"""Draws the pages of a study and a chat in the terminal, for the documentation.

Serves a study of the shipped agent, takes part in it by Chromium, and writes
docs/figures/study_*.png; talks with the same agent in a terminal of rich, and writes
docs/figures/chat.svg. Needs the extras study and chat, the package playwright and the program
chromium (Debian's):

    python scripts/draw_talks.py
"""

from __future__ import annotations

import io
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
AGENT = "shipped:bbqn_map"
STUDY = f"""
name: Booking movie tickets
consent: |
  In this study you talk with a computer that books movie tickets, and rate it.

  What you type is stored without your name. You may stop at any time.
contact: study@lab.example
agents: {{bbqn: "{AGENT}"}}
pairs: []
participants: 2
goals: [1]
"""
SAID = (
    "Hi, two tickets for Top Gun: Maverick please",
    "6:40 pm",
    "my zip code is 98101",
    "century seattle southgate 16",
    "what day is it on?",
)
WIDTH, WIDE, HEIGHT = 720, 1000, 1350  # tables of the researcher are wide
COLORS = 48


def main() -> None:
    """Draws everything."""
    if shutil.which("chromium") is None:
        sys.exit("error: this needs the program chromium: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        draw_study(Path(folder) / "study.yaml")
    draw_chat(FIGURES / "chat.svg")


def draw_study(file: Path) -> None:
    """Draws consent, goal card, conversation, rating and the researcher's transcript."""
    from playwright.sync_api import sync_playwright

    file.write_text(STUDY, encoding="utf-8")
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port = str(bound.getsockname()[1])
    command = [sys.executable, "-m", "bbq_torchrl.people.study", "serve", str(file), "--port", port]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert server.stdout is not None
        lines = [server.stdout.readline() for _ in range(2)]
        people, researcher = (re.findall(r"http\S+", line)[0] for line in lines)
        with sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"]
            )
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            _open(page, people)
            _shoot(page, "consent")
            page.get_by_role("checkbox").check()
            page.get_by_role("button", name="Begin").click()
            page.wait_for_url("**/p/*")
            _shoot(page, "goal")
            for text in SAID:
                page.get_by_label("Your message").fill(text)
                page.get_by_role("button", name="Send").click()
                page.wait_for_load_state()
            _shoot(page, "conversation")
            page.get_by_role("button", name="End this conversation").click()
            page.get_by_label("no", exact=True).check()
            _shoot(page, "rating", form=True)
            page.set_viewport_size({"width": WIDE, "height": HEIGHT})
            page.goto(researcher)
            page.locator(f"a[href*='{researcher.rsplit('/', 1)[1]}/']").first.click()
            page.wait_for_load_state()
            _shoot(page, "researcher")
            browser.close()
    finally:
        server.terminate()
        server.wait()


def _open(page: Page, link: str) -> None:
    """Opens a page of a server that may still be starting."""
    for _ in range(100):
        try:
            page.goto(link)
        except Exception as error:
            if "ERR_CONNECTION_REFUSED" not in str(error):
                raise
            page.wait_for_timeout(200)
        else:
            return


def _shoot(page: Page, name: str, form: bool = False) -> None:
    """Writes a small picture of a page, or of its form only."""
    from PIL import Image

    if form:
        shot = page.locator("form").first.screenshot(animations="disabled")
    else:
        size = page.viewport_size or {"width": WIDTH}
        height = page.evaluate("document.documentElement.scrollHeight")
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(height, HEIGHT)}
        shot = page.screenshot(full_page=True, clip=clip, animations="disabled", caret="hide")
    image = Image.open(io.BytesIO(shot)).convert("RGB").quantize(COLORS)
    image.save(FIGURES / f"study_{name}.png", optimize=True)


def draw_chat(file: Path) -> None:
    """Draws a chat in the terminal."""
    import torch
    from rich.console import Console

    from bbq_torchrl.people.chat import Partner, TrainedAgent
    from bbq_torchrl.people.chat.terminal import Chat
    from bbq_torchrl.people.dialogue.judge import choose_goal
    from bbq_torchrl.people.language import Generator, load_phrases
    from bbq_torchrl.people.language.understander import cached_understander

    torch.set_num_threads(1)
    agent = TrainedAgent(AGENT)
    screen = Console(record=True, file=io.StringIO(), width=84, force_terminal=True)
    lines = iter([SAID[0], "/acts", "/why", *SAID[1:], "yes please"])

    def read() -> str | None:
        line = next(lines, None)
        if line is not None:
            screen.print(f"you: {line}", markup=False, highlight=False)
        return line

    names = load_phrases(agent.domain).names
    partner = Partner(agent, cached_understander(agent.domain), Generator(agent.domain))
    Chat(partner, choose_goal(partner.domain, 1, 0), screen, names=names).run(read)
    drawn = screen.export_svg(title=f"bbq chat {AGENT} --goal 1")
    # Any font of the reader works; no font is loaded from another host.
    file.write_text(re.sub(r"@font-face \{.*?\}\s*", "", drawn, flags=re.S), encoding="utf-8")


if __name__ == "__main__":
    main()
