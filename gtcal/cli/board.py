"""gtcal board: draw a calibration board to print."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import tyro

if TYPE_CHECKING:
    from gtcal.board import Board

BoardType = Literal["aruco_grid", "aprilgrid", "charuco", "chessboard", "dot_grid"]


def board(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    *,
    preset: Literal["paper_a2", "chessboard", "dots"] | None = None,
    type: BoardType | None = None,
    file: Path | None = None,
    lollypop: bool = False,
    dictionary: str | None = None,
    family: str | None = None,
    tag_columns: int | None = None,
    tag_rows: int | None = None,
    tag_side_mm: float | None = None,
    tag_gap_mm: float | None = None,
    tag_spacing: float | None = None,
    first_tag_id: int | None = None,
    corner_squares: bool | None = None,
    square_columns: int | None = None,
    square_rows: int | None = None,
    square_side_mm: float | None = None,
    marker_side_mm: float | None = None,
    dot_columns: int | None = None,
    dot_rows: int | None = None,
    dot_pitch_mm: float | None = None,
    dot_diameter_mm: float | None = None,
    asymmetric: bool | None = None,
    page: str | None = None,
    dpi: int = 300,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Draw a calibration board to scale, and print the lines that describe it in a recording's manifest.

    Without --preset, --type or --file it is the paper's board, paper_a2. Print at 100 % ("actual size"), measure the
    printed ruler, and glue the sheet on something flat and stiff: gtcal takes the board as plane.

        gtcal board -o board.pdf
        gtcal board -o april.pdf --type aprilgrid --tag-columns 6 --tag-rows 6 --tag-side-mm 88 --tag-spacing 0.3
        gtcal board -o charuco.png --type charuco --dictionary DICT_5X5_100 --square-columns 8 --square-rows 6
            --square-side-mm 40 --marker-side-mm 30
        gtcal board -o chessboard.pdf --type chessboard --square-columns 9 --square-rows 6 --square-side-mm 40
        gtcal board -o dots.pdf --type dot_grid --dot-columns 4 --dot-rows 11 --dot-pitch-mm 60 --asymmetric

    Boards with codes are found where only a part of them is seen; a chessboard or a grid of dots only as a whole.

    Args:
        output: File to write: .pdf or .svg for a print shop, .png for a screen.
        preset: 'paper_a2': A2, 24 ArUco tags of 59 mm, 29.5 mm apart, black squares at all crossings of the gaps, so
            that every tag corner is as sharp as a chessboard's. 'chessboard': A2, 11 x 8 squares of 45 mm. 'dots': A2,
            an asymmetric grid of 7 x 9 dots of 25 mm, 70 mm apart.
        type: 'aruco_grid': tags of an OpenCV dictionary. 'aprilgrid': Kalibr's. 'charuco': OpenCV's ChArUco board.
            'chessboard': a plain one; with an even and an odd number of squares it has one way up. 'dot_grid': dots in
            columns and rows.
        file: YAML file with a board block as in a recording's manifest.
        lollypop: Draw the device to verify with, the paper's or with --file one described there: its tag, and where its
            retroreflective discs go.
        dictionary: aruco_grid and charuco: OpenCV's name, as DICT_4X4_50.
        family: aprilgrid: AprilTag family (default 36h11).
        tag_columns: aruco_grid, aprilgrid: tags across.
        tag_rows: aruco_grid, aprilgrid: tags down.
        tag_side_mm: aruco_grid, aprilgrid: side of a tag's black square.
        tag_gap_mm: aruco_grid: the white between two tags.
        tag_spacing: aprilgrid: the gap over the side of a tag (0.3 on Kalibr's boards).
        first_tag_id: aruco_grid, aprilgrid: the lowest id (default 0). Boards that may be seen together need
            different ids.
        corner_squares: aruco_grid: black squares at all crossings of the gaps. Corners are found about five times more
            precisely with them.
        square_columns: charuco, chessboard: chessboard squares across.
        square_rows: charuco, chessboard: chessboard squares down.
        square_side_mm: charuco, chessboard: side of a square.
        marker_side_mm: charuco: side of the marker in a white square.
        dot_columns: dot_grid: dots in a row.
        dot_rows: dot_grid: rows of dots.
        dot_pitch_mm: dot_grid: from a dot to the next of its row, centre to centre.
        dot_diameter_mm: dot_grid: of a dot (default: half the pitch; of asymmetric grids a quarter).
        asymmetric: dot_grid: every other row is shifted by half the pitch, and rows are half the pitch apart. With an
            odd number of rows it has one way up.
        page: A4 to A0, or millimetres as 500x400; by default the smallest of A4 to A0 that holds the board.
        dpi: Resolution of a PNG; it is stored in the file.
        quiet: Print nothing.
    """
    from gtcal.drawing import draw_board
    from gtcal.files import check_outputs

    check_outputs([output], [file] if file is not None else ())
    if lollypop:
        _draw_lollypop(output, file, page, dpi, quiet)
        return
    given = {
        "type": type,
        "dictionary": dictionary,
        "family": family,
        "tag_columns": tag_columns,
        "tag_rows": tag_rows,
        "tag_side_m": _metres(tag_side_mm),
        "tag_gap_m": _metres(tag_gap_mm),
        "tag_spacing": tag_spacing,
        "first_tag_id": first_tag_id,
        "corner_squares": corner_squares,
        "square_columns": square_columns,
        "square_rows": square_rows,
        "square_side_m": _metres(square_side_mm),
        "marker_side_m": _metres(marker_side_mm),
        "dot_columns": dot_columns,
        "dot_rows": dot_rows,
        "dot_pitch_m": _metres(dot_pitch_mm),
        "dot_diameter_m": _metres(dot_diameter_mm),
        "asymmetric": asymmetric,
    }
    chosen = _chosen_board(preset, file, {name: value for name, value in given.items() if value is not None})
    sheet = draw_board(chosen, output, page=page, dpi=dpi)
    if not quiet:
        print(f"{output}: {chosen.describe()}, on {1000 * sheet.width_m:g} x {1000 * sheet.height_m:g} mm")
        print("Print at 100 % and measure the ruler. In the recording's manifest:\n")
        print(_manifest_lines(chosen))


def _metres(length_mm: float | None) -> float | None:
    return None if length_mm is None else round(length_mm / 1000, 9)


def _chosen_board(preset: str | None, file: Path | None, given: dict[str, object]) -> Board:
    """The one board that the options describe. Raises GtcalError where they describe none or several."""
    from gtcal.board import board_from_manifest, load_board
    from gtcal.errors import GtcalError

    ways = [name for name, way in (("--preset", preset), ("--file", file), ("--type", given.get("type"))) if way]
    if len(ways) > 1:
        raise GtcalError(f"{' and '.join(ways)} both describe a board; give one")
    if given and ways != ["--type"]:
        option = re.sub("_m$", "_mm", next(iter(given))).replace("_", "-")
        raise GtcalError(f"--{option} needs --type ({', '.join(get_args(BoardType))}), and all that the type has")
    if file is not None:
        return load_board(str(file))
    return board_from_manifest(given if given else {"preset": preset or "paper_a2"})


def _manifest_lines(board: Board) -> str:
    import yaml

    from gtcal.board import PRESETS

    presets = [name for name, known in PRESETS.items() if known == board]
    block = {"preset": presets[0]} if presets else board.to_manifest()
    return str(yaml.safe_dump({"board": block}, sort_keys=False))


def _draw_lollypop(output: Path, file: Path | None, page: str | None, dpi: int, quiet: bool) -> None:
    import yaml

    from gtcal.verification.lollypop import DEVICE_PRESETS, PAPER_LOLLYPOP
    from gtcal.verification.lollypop_drawing import draw_lollypop
    from gtcal.verification.lollypop_recording import read_device

    device = DEVICE_PRESETS[PAPER_LOLLYPOP] if file is None else read_device(file)
    sheet = draw_lollypop(device, output, page=page, dpi=dpi)
    if not quiet:
        print(f"{output}: {device.describe()}, on {1000 * sheet.width_m:g} x {1000 * sheet.height_m:g} mm")
        print("Print at 100 %, measure the ruler, and put the discs on the circles. In the recording's manifest:\n")
        print(yaml.safe_dump({"device": device.to_manifest()}, sort_keys=False))
