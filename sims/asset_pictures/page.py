"""One HTML file that needs no network: headings, lines of text, and rows of pictures with a caption each."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2

from asset_pictures.drawing import Picture

STYLE = (
    "body{font-family:sans-serif;max-width:1180px;margin:2em auto;color:#222}figure{display:inline-block;margin:4px;"
    "vertical-align:top}figcaption{font-size:80%;max-width:320px}img{border:1px solid #ddd}td,th{padding:2px 10px;"
    "text-align:right}"
)
Row = Sequence[tuple[str, Picture]]


def write_page(file: Path, title: str, parts: Sequence[tuple[str, Sequence[str], Row]]) -> Path:
    """Write a page of parts, each a heading, lines of text and captioned RGB pictures; returns the file."""
    body = [f"<h1>{escape(title)}</h1>"]
    for heading, lines, row in parts:
        body.append(f"<h2>{escape(heading)}</h2>")
        body += [f"<p>{escape(line)}</p>" for line in lines]
        body += [
            f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{_png(image)}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, image in row
        ]
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title><style>{STYLE}</style>"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([head, *body, "</html>"]), encoding="utf-8")
    return file


def _png(image: Picture) -> str:
    return base64.b64encode(cv2.imencode(".png", image[..., ::-1])[1].tobytes()).decode()
