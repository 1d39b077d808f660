"""`uwoc-gym reproduce`: every figure and table of the paper, its numbers beside ours."""

from __future__ import annotations

import argparse
import time

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import require
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.reports.documents import Table, markdown, page
from uwoc_gym.agents.reports.reproduction import fly_and_draw, report_blocks
from uwoc_gym.agents.reports.tables import grid

HELP = "fly the paper's simulations and write every figure and table of it, published beside computed"
EXAMPLES = """\
examples:
  uwoc-gym reproduce --out reproduction
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="folder for report.html, report.md, results.json and the figures as PNG and SVG",
    )


def run(args: argparse.Namespace) -> int:
    """Fly, draw and report; returns the exit status."""
    require("tqdm", "matplotlib")
    folder = files.output_folder(args.out)
    begun = time.perf_counter()
    results, scenarios, figures = fly_and_draw(folder)
    blocks = report_blocks(results)
    files.write_text(folder / "report.md", markdown(blocks))
    files.write_text(folder / "report.html", page("The paper's figures and tables, flown again", blocks, folder))
    document = {"finished": True, **results, "wall_time_s": round(time.perf_counter() - begun, 3)}
    files.write_results(folder, args.command_line, scenarios, document)
    for block in blocks:
        if isinstance(block, Table) and "RMSE" in block.header[1]:
            print(f"{grid(block.header, block.rows)}\n")
    print(f"{len(figures)} figures, report.md, report.html and results.json are in {places.address(folder)}")
    return 0
