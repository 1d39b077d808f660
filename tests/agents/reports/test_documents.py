"""Documents."""

from __future__ import annotations

from uwoc_gym.agents.reports.documents import Heading, Paragraph, Picture, Table, markdown, page


def test_document_escapes_html_and_lines_up_tables(tmp_path):
    (tmp_path / "a.svg").write_text("<svg/>", encoding="utf-8")
    blocks = [Heading("a < b", 1), Paragraph("x & y"), Table(["", "n"], [["one", "1"]], "c"), Picture("a", "p")]
    html = page("t", blocks, tmp_path)
    assert "<h1>a &lt; b</h1>" in html
    assert "<p>x &amp; y</p>" in html
    assert markdown(blocks).startswith("# a < b\n\nx & y\n\n|     | n |")
