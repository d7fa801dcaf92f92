"""The report says where probability went that no name and no alternative has, and no guess in its headline."""

from __future__ import annotations

import pytest

from tests import gap_bench as bench
from twin_diagram.gap.findings import TUNING as FINDINGS
from twin_diagram.gap.findings import Alternative, Rest
from twin_diagram.gap.report import section_found, words


def test_the_rest_is_said_with_its_share() -> None:
    rest = Rest(others=0.07, nothing=0.004, unseen=0.11, nameless=0.25)
    text = words.rest(bench.friction_finding(confidence=0.5, rest=rest))
    assert text.startswith("The rest: other explanations, each less probable (7 %), more joints of the same kind")
    assert text.endswith("show it (11 %) and something that has no name in the catalogue (25 %).")
    assert "no effect in its place" not in text  # next to none
    assert "no effect in its place (4 %)" in words.rest(bench.friction_finding(rest=Rest(nothing=0.04)))
    assert words.rest(bench.friction_finding()) == ""


def test_it_stands_below_the_alternatives() -> None:
    others = (Alternative("viscous_friction", ("elbow",), (), 0.2),)
    finding = bench.friction_finding(confidence=0.7, alternatives=others, rest=Rest(others=0.1))
    html = section_found._finding(finding, several=False, prismatic=frozenset())
    assert html.index("It could also be: viscous friction on elbow (20 %).") < html.index(
        "The rest: other explanations"
    )


@pytest.mark.parametrize("sure", [FINDINGS.guess - 1e-6, FINDINGS.guess])
def test_the_headline_holds_no_guess(sure: float) -> None:
    findings = [bench.payload_finding(), bench.friction_finding(confidence=sure)]
    text = words.headline(bench.verdict("named", findings))
    guess = sure < FINDINGS.guess
    assert findings[1].is_guess() == guess == (words.sureness(sure) == "a guess")
    assert ("dry friction" in text) != guess
    assert "payload" in text and ("guess at only" in text) == guess


def test_where_all_is_guessed_the_headline_says_no_more() -> None:
    text = words.headline(bench.verdict("named", [bench.friction_finding(confidence=0.3)]))
    assert text == "Something is missing that these runs allow to guess at only."
