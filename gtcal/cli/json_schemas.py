"""Everything that gtcal reads and prints as JSON, by name: its model, whose JSON schema 'gtcal schema NAME' prints."""

from __future__ import annotations

from typing import Any

from gtcal.cli import fleet_models as fleet
from gtcal.cli import result_models as results
from gtcal.recordings.manifest import Entry, manifest_schema
from gtcal.verification.lollypop_recording import lollypop_manifest_schema

MODELS: dict[str, type[Entry]] = {
    "jobs": fleet.Jobs,
    "calibration": results.Calibration,
    "pose-calibration": results.PoseCalibration,
    "verification": results.Verification,
    "drift": results.Drift,
    "selfcheck": results.SelfCheck,
    "comparison": results.Comparison,
    "pose-comparison": results.PoseComparison,
    "uncertainty": results.Uncertainty,
    "difference": results.Difference,
    "diagnosis": results.Diagnosis,
    "summary": results.Summary,
    "mocap-file": results.MocapFile,
    "draft": results.Draft,
    "detection": results.Detection,
    "demo": results.Demo,
    "batch": fleet.BatchResult,
    "batch-plan": fleet.BatchPlan,
    "history": fleet.HistoryResult,
    "watch": fleet.WatchLine,
}
"""All but the manifests of recordings."""

NAMES = ("recording", "lollypop-recording", *MODELS)

PRINTED_BY: dict[str, tuple[str, ...]] = {
    "calibrate": ("calibration", "pose-calibration"),
    "verify": ("verification",),
    "drift": ("drift",),
    "selfcheck": ("selfcheck",),
    "compare": ("comparison", "pose-comparison"),
    "uncertainty": ("uncertainty",),
    "diff": ("difference",),
    "doctor": ("diagnosis",),
    "info": ("summary", "mocap-file", "calibration", "verification"),
    "init": ("draft",),
    "detect": ("detection",),
    "demo": ("demo", "history"),
    "batch": ("batch", "batch-plan"),
    "history": ("history",),
    "watch": ("watch",),
}
"""What each command that has a table prints with --json; 'gtcal watch' always."""


def schema_of(name: str) -> dict[str, Any]:
    """The JSON schema of one of ``MODELS``, or of a manifest."""
    manifests = {"recording": manifest_schema, "lollypop-recording": lollypop_manifest_schema}
    if name in manifests:
        return manifests[name]()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **MODELS[name].model_json_schema()}
