"""OpenCV's two chessboard detectors as their users call them, and the judgement of what a detector returned."""

from __future__ import annotations

import cv2
import numpy as np

_ADAPTIVE, _NORMALIZE, _FILTER = (
    cv2.CALIB_CB_ADAPTIVE_THRESH,
    cv2.CALIB_CB_NORMALIZE_IMAGE,
    cv2.CALIB_CB_FILTER_QUADS,
)
_EXHAUSTIVE = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
CLASSIC = {"": _ADAPTIVE | _NORMALIZE, "plain": 0, "filter": _ADAPTIVE | _NORMALIZE | _FILTER}
SECTOR = {"": _EXHAUSTIVE, "plain": 0, "normalize": _NORMALIZE, "both": _EXHAUSTIVE | _NORMALIZE}


def judge(corners, truth, board):
    """ "found", "missed" or "wrong"."""
    if corners is None:
        return "missed"
    corners = np.asarray(corners).reshape(-1, 2)
    spacing = np.linalg.norm(np.diff(truth.reshape(board[1], board[0], 2), axis=1), axis=2).min()
    grid = corners.reshape(board[1], board[0], 2)
    options = [grid, grid[::-1, ::-1], grid[:, ::-1], grid[::-1]]
    if board[0] == board[1]:
        options += [g.transpose(1, 0, 2) for g in options]
    error = min(np.abs(g.reshape(-1, 2) - truth).max() for g in options)
    return "found" if error < max(1.5, 0.1 * spacing) else "wrong"


def verdicts(gray, truth, board, *, until_found=False):
    """{detector and flags: verdict} of findChessboardCorners and findChessboardCornersSB under their usual flags.

    With `until_found` the first that finds the board is the last that is asked: enough to know whether any does.
    """
    result = {}
    for name, find, settings in (
        ("classic", cv2.findChessboardCorners, CLASSIC),
        ("SB", cv2.findChessboardCornersSB, SECTOR),
    ):
        for setting, flags in settings.items():
            ok, corners = find(gray, board, None, flags)
            result[f"{name} {setting}".strip()] = judge(corners if ok else None, truth, board)
            if until_found and "found" in result.values():
                return result
    return result


class Tally:
    """Counts a detector's verdicts over a scene and remembers why ours failed."""

    def __init__(self):
        self.counts = {who: {"found": 0, "missed": 0, "wrong": 0} for who in ("ours", "classic", "SB", "any")}
        self.behind, self.reasons = 0, []

    def add(self, number, ours, theirs, reason):
        """One image: our verdict, theirs (may be empty where they were not asked), and our message."""
        self.counts["ours"][ours] += 1
        if theirs:
            for who in ("classic", "SB"):
                self.counts[who][theirs.get(who, "missed")] += 1
            self.counts["any"]["found" if "found" in theirs.values() else "missed"] += 1
        finders = [who for who, verdict in theirs.items() if verdict == "found"]
        if ours != "found":
            self.behind += bool(finders)
            self.reasons.append(f"{number} {ours}: {reason[:100]}" + (f"  [found by {finders}]" if finders else ""))

    def line(self, name, total):
        """The scene's line of the table."""
        ours, rest = self.counts["ours"], [self.counts[who] for who in ("classic", "SB")]
        parts = [f"{c['found']:3}/{total}, {c['wrong']} wrong" for c in (ours, *rest)]
        return f"{name:16} | {' | '.join(parts)} | {self.counts['any']['found']:3} | {self.behind}"


HEADER = f"{'scene':16} | stereocal       | classic        | SB             | any of 7 | found by any, not by us"
