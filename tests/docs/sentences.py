"""Sentences drawn at random from README, pages and command help, to be read by a technical writer.

`python -m tests.docs.sentences --seed 1` prints a hundred of them with their places. One that has to be read
twice, or that says what another page already says better, is mended where it stands; a fresh seed then judges
again. Decision records and blocks of code are left out.
"""

import argparse
import random
import re
from collections.abc import Iterator

from docs.generate.pages import DOCS, ROOT
from docs.generate.reference import every_command

LEAST_WORDS = 5
"""Shorter ones are names, headings of tables and values."""


def of_text(text: str) -> Iterator[str]:
    """Give the sentences of Markdown: of paragraphs, items of lists and cells of tables."""
    text = re.sub(r"\A---\n.*?\n---\n|^ *```.*?^ *```$|^    .*?$", "", text, flags=re.S | re.M)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)|\*\*", "", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[*-]|\d+\.|\||#))|(?<!\\)\|", text):
        line = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split())).strip("#* ")
        for sentence in re.split(r"(?<=[.?!:])\s+(?=[A-Z`*\"])", line):
            if len(re.sub("`[^`]*`", "", sentence).split()) >= LEAST_WORDS:
                yield sentence


def every_sentence() -> list[tuple[str, str]]:
    """Give each sentence with the first place where it stands."""
    pages = [ROOT / "README.md", *(p for p in sorted(DOCS.rglob("*.md")) if "decisions" not in p.parts)]
    drawn_from = [(page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")) for page in pages]
    for name, command in every_command():
        parameters = [getattr(parameter, "help", None) or "" for parameter in command.params]
        drawn_from.append((f"fpplab {name} --help", "\n\n".join([command.help or "", *parameters])))
    first = {sentence: place for place, text in reversed(drawn_from) for sentence in of_text(text)}
    return sorted((place, sentence) for sentence, place in first.items())


def drawn(seed: int, count: int) -> list[tuple[str, str]]:
    """Draw sentences without replacement; the same for a seed as long as the texts are the same."""
    return random.Random(seed).sample(every_sentence(), count)


def main() -> None:
    """Print what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=100)
    options = parser.parse_args()
    for number, (place, sentence) in enumerate(drawn(options.seed, options.count), 1):
        print(f"{number:3d}  {place}\n     {sentence}\n")


if __name__ == "__main__":
    main()
