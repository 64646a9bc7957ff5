"""The commands of a page of the documentation."""

import re
import shlex
import shutil
import subprocess

from turtlebag.pipeline.cli.main import main

BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.M | re.S)


def commands(text):
    """Lines of the ```sh blocks, with the exit code that a trailing `# exit N` promises."""
    lines = [line for kind, block in BLOCK.findall(text) if kind == "sh" for line in block.splitlines()]
    return [(line, int((re.findall(r"# exit (\d)$", line) or ["0"])[0])) for line in lines if line.strip()]


def run_page(page, folder, monkeypatch, instead=None):
    """Run the commands of a page in a folder as written, each with the exit code that it promises.

    `instead`: what words are written otherwise.
    """
    monkeypatch.chdir(folder)
    for example in re.findall(r"\]\((examples/\w+\.py)\)", page.read_text()):
        shutil.copy(page.parent / example, folder)
    for line, expected in commands(page.read_text()):
        for words, others in (instead or {}).items():
            line = line.replace(f"turtlebag {words}", f"turtlebag {others}")
        if line.startswith("turtlebag "):
            code = main(shlex.split(line, comments=True)[1:])
        else:
            code = subprocess.run(line, shell=True, check=False).returncode
        assert code == expected, line
