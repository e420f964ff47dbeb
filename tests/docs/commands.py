"""Every command line of README and of the pages: those in code blocks, and those that a sentence mentions."""

import argparse
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ambler.cli.main import build_parser

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
_COMMAND = re.compile(r"(?:\.venv/bin/)?ambler (.*)|\./run\.sh\b(.*)")


@dataclass(frozen=True)
class Command:
    """The words after `ambler`; `./run.sh` is `ambler demo`."""

    page: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return shlex.join(self.words)


def _command(page: Path, line: str) -> Command | None:
    found = _COMMAND.fullmatch(line.strip())
    if found is None:
        return None
    verb, options = found.groups()
    text = f"demo {options}" if verb is None else verb
    return Command(page.stem, tuple(shlex.split(text, comments=True)))


def _split(page: Path) -> tuple[list[str], str]:
    """Return the lines of a page's shell blocks, and its text without any blocks."""
    lines: list[str] = []
    text: list[str] = []
    language: str | None = None
    for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        if line.startswith("```"):
            language = line[3:].strip() if language is None else None
        elif language is None:
            text.append(line)
        elif language in ("", "bash", "sh"):
            lines.append(line)
    return lines, "\n".join(text)


def block_commands() -> Iterator[Command]:
    """Give each command of a code block; it can be typed as it stands."""
    for page in PAGES:
        for line in _split(page)[0]:
            if command := _command(page, line):
                yield command


def mentioned_commands() -> Iterator[Command]:
    """Give each command in the text; it may hold placeholders and leave out what does not matter there."""
    for page in PAGES:
        for line in re.findall(r"`([^`\n]+)`", _split(page)[1]):
            if command := _command(page, line):
                yield command


BLOCKS = {str(command): command for command in block_commands()}
"""Each command of a code block by its text."""


def _sub_parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of a verb's sub-verbs by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def parser_of(command: Command) -> argparse.ArgumentParser:
    """Return the parser of a command's verb and sub-verb."""
    parser = build_parser()
    for word in command.words:
        if word == "…" or not (choices := _sub_parsers(parser)):
            break
        if word not in choices and parser.prog.endswith("calibrate"):
            break
        parser = choices[word]
    return parser


def lengthened(command: Command, more: Sequence[str]) -> list[str]:
    """Return the words of a command with more options, which override those that it has: before its goals, which may follow on `--`."""
    words = list(command.words)
    end = words.index("--") if "--" in words else len(words)
    return [*words[:end], *more, *words[end:]]
