"""Pages for people, from tables and pictures: a rule for each entry of the table below."""

PAGES = {
    "front_page": {
        "shows": "A campaign at a glance, on the page that a person opens first: how good it is, every page, file and picture.",
        "calls": "thalweg.figures.front:write_front_page",
        "page": f"{RESULTS}/index.html",
        "inputs": {
            "results": of(CampaignFiles.shown_in_front),
            "pictures": lambda wildcards: FIGURES.files(FILES[wildcards.campaign]),
        },
        "params": {
            "lacking": of(CampaignFiles.lacking),
            "figures": {row.name: (row.category, row.shows) for row in FIGURES.rows},
            "crs": CRS,
        },
    },
    "accuracy_page": {
        "shows": "Everything that was found out about the accuracy of a cloud, on one page.",
        "calls": "thalweg.figures.accuracy.page:accuracy_page",
        "page": f"{RESULTS}/accuracy/index.html",
        "inputs": {
            "facts": f"{RESULTS}/accuracy/cloud_to_mesh.parquet",
            "statistics": f"{RESULTS}/accuracy/statistics.csv",
            "by_range": f"{RESULTS}/accuracy/by_range.csv",
            "registration": f"{RESULTS}/accuracy/registration.json",
            "mesh_facts": f"{RESULTS}/surface/reference_mesh.json",
            "error_model": f"{RESULTS}/orientation/error_model.json",
            "truth": of(CampaignFiles.truth_statistics),
            "pictures": of_page("accuracy"),
        },
        "params": {"captions": FIGURES.captions("accuracy")},
    },
    "photographs_page": {
        "shows": "Photographs without a boat: places, check points, lens, what has no pose.",
        "calls": "thalweg.figures.images.photographs:orientation_page",
        "page": f"{RESULTS}/photographs/index.html",
        "inputs": {
            "facts": f"{RESULTS}/photographs/orientation.json",
            "images": f"{RESULTS}/photographs/images.csv",
            "control": f"{RESULTS}/photographs/control_points.csv",
            "pictures": of_page("photographs"),
        },
        "params": {"captions": FIGURES.captions("photographs")},
    },
    "finished_photographs_page": {
        "shows": "Photographs that another program has oriented: places, check points, what has no pose.",
        "calls": "thalweg.figures.images.photographs:finished_page",
        "page": f"{RESULTS}/photographs/finished.html",
        "inputs": {
            "facts": f"{RESULTS}/photographs/finished.json",
            "poses": f"{RESULTS}/photographs/finished.csv",
            "control": f"{RESULTS}/photographs/finished_points.csv",
            "pictures": of_page("finished_photographs"),
        },
        "params": {"captions": FIGURES.captions("finished_photographs")},
    },
    "fixed_camera_page": {
        "shows": "A camera that stays: its place from picture to picture.",
        "calls": "thalweg.figures.images.fixed_camera:fixed_camera_page",
        "page": f"{RESULTS}/orientation/fixed_camera.html",
        "inputs": {
            "facts": f"{RESULTS}/orientation/fixed_camera.json",
            "poses": f"{RESULTS}/orientation/fixed_camera.csv",
            "pictures": of_page("fixed_camera"),
        },
        "params": {"captions": FIGURES.captions("fixed_camera")},
    },
    "cloud_page": {
        "shows": "A finished cloud beside a reference: distances, statistics, registration.",
        "calls": "thalweg.figures.accuracy.cloud:cloud_page",
        "page": f"{RESULTS}/accuracy/cloud.html",
        "inputs": {
            "facts": f"{RESULTS}/accuracy/cloud.json",
            "pictures": of_page("cloud"),
        },
        "params": {"captions": FIGURES.captions("cloud")},
    },
    "calibration_page": {
        "shows": "Everything that a calibration found out, on one page.",
        "calls": "thalweg.figures.calibration.page:write_calibration_page",
        "page": f"{RESULTS}/calibration/index.html",
        "inputs": {
            "calibrations": of(CampaignFiles.found_calibrations),
            "tables": of(CampaignFiles.calibration_tables),
            "facts": of(CampaignFiles.calibration_facts),
            "truth": of(CampaignFiles.calibration_truth),
            "pictures": of_page("calibration"),
        },
        "params": {"captions": FIGURES.captions("calibration")},
    },
    "trajectory_comparison_page": {
        "shows": "INS, camera and fused trajectory side by side, on one page (T 3.1.4).",
        "calls": "thalweg.figures.solutions.page:write_trajectory_comparison_page",
        "page": f"{RESULTS}/accuracy/trajectories.html",
        "inputs": {
            "chains": f"{RESULTS}/accuracy/chains.csv",
            "by_range": f"{RESULTS}/accuracy/chains_by_range.csv",
            "facts": f"{RESULTS}/accuracy/chains.json",
            "camera_facts": f"{RESULTS}/orientation/camera_trajectory.json",
            "fused_facts": f"{RESULTS}/orientation/fused.json",
            "control": of(CampaignFiles.control_reports),
            "trajectories": of(CampaignFiles.trajectories),
            "truth": where(CampaignFiles.is_twin, "accuracy/chains_truth.csv"),
            "pictures": of_page("trajectories"),
        },
        "params": {
            "captions": FIGURES.captions("trajectories"),
            "steps": of(CampaignFiles.chain_steps),
        },
    },
    "light_sheet_page": {
        "shows": "Calibration, panels, budget, models and all that was rejected, on one page (P3, P4).",
        "calls": "thalweg_lab.figures.ledger_table:write_light_sheet_page",
        "page": f"{RESULTS}/triangulation/index.html",
        "inputs": {
            "calibration": f"{RESULTS}/triangulation/calibration.json",
            "camera": f"{RESULTS}/triangulation/camera.json",
            "budget": f"{RESULTS}/triangulation/budget.csv",
            "lens": of(CampaignFiles.sheet_lens_report),
            "panels": of(CampaignFiles.sheet_panels),
            "truth": of(CampaignFiles.sheet_truth),
            "counts": of(CampaignFiles.of_sheet_series, "line_counts.csv"),
            "line_points": of(CampaignFiles.of_sheet_series, "line_points.parquet"),
            "scan_files": of(CampaignFiles.sheet_scan_files),
            "scan_pictures": of_page("scans"),
            "pictures": of_page("light_sheet"),
            "ledger": of(laboratory.ledger_table),
        },
        "params": {
            "captions": FIGURES.captions("light_sheet", "scans"),
            "scans": of(CampaignFiles.scan_names),
        },
    },
    "bed_strip_page": {
        "shows": "A strip of the bed under the boat on one page (T 3.2).",
        "calls": "thalweg.lightsheet.figures.page:strip_page",
        "page": f"{RESULTS}/triangulation/strip/index.html",
        "inputs": {
            "counts": f"{RESULTS}/triangulation/strip/counts.json",
            "pictures": of_page("strip"),
        },
        "params": {"captions": FIGURES.captions("strip")},
    },
    "bathymetry_page": {
        "shows": "The riverbed: how deep, how sure, and what that rests on.",
        "calls": "thalweg.figures.bathymetry.page:bed_page",
        "page": f"{RESULTS}/bathymetry/index.html",
        "inputs": {
            "facts": f"{RESULTS}/bathymetry/soundings.json",
            "variogram": f"{RESULTS}/bathymetry/variogram.json",
            "level": f"{RESULTS}/bathymetry/water_level.json",
            "banks": f"{RESULTS}/bathymetry/banks.csv",
            "validation": f"{RESULTS}/bathymetry/validation.json",
            "methods": f"{RESULTS}/bathymetry/methods.csv",
            "river": f"{RESULTS}/fusion/river.json",
            "fit": f"{RESULTS}/fusion/fit.json",
            "truth": of(CampaignFiles.bed_truth),
            "pictures": of_page("bathymetry"),
        },
        "params": {"captions": FIGURES.captions("bathymetry")},
    },
    "deformation_page": {
        "shows": "What changed between epochs, how sure that is and what nobody saw, on one page (T 4.1).",
        "calls": "thalweg.figures.deformation.page:write_change_page",
        "page": f"{RESULTS}/deformation/index.html",
        "inputs": {
            "errors": of(CampaignFiles.all_epochs, "errors.json"),
            "changes": of(CampaignFiles.of_pairs, "changes_{}.parquet"),
            "visibility": of(CampaignFiles.of_pairs, "visibility_{}.parquet"),
            "control": of(CampaignFiles.of_pairs, "changes_{}.json"),
            "registrations": of(CampaignFiles.of_pairs, "registration_{}.json"),
            "volumes": of(CampaignFiles.of_pairs, "volumes_{}.csv"),
            "patches": of(CampaignFiles.of_pairs, "patches_{}.csv"),
            "differences": of(CampaignFiles.of_pairs, "dod_{}.csv"),
            "core_points": f"{RESULTS}/deformation/core_points.parquet",
            "series": of(CampaignFiles.change_series),
            "truth": of(CampaignFiles.change_truth),
            "polygons": of(CampaignFiles.change_truth, "truth_polygons_{}.csv"),
            "pictures": of_page("deformation"),
        },
        "params": {
            "captions": lambda wildcards: FIGURES.captions(
                "deformation",
                of_files=not FILES[wildcards.campaign].has_boat_epoch(),
            ),
            "by_boat": of(CampaignFiles.has_boat_epoch),
        },
    },
}

for name, entry in PAGES.items():

    rule:
        name:
            name
        input:
            **entry["inputs"],
        output:
            page=entry["page"],
        resources:
            mem_mb=memory(1500),
            runtime=minutes(10),
        params:
            **entry["params"],
            **calls(entry["calls"], "page"),
            twin=TWIN,
            title=TITLE,
        script:
            "../scripts/page.py"


rule survey_report:
    """Report of survey, or of change, to hand in: PDF of all chosen results with checksums of the products."""
    input:
        tables=reported,
        trajectory=of(CampaignFiles.page_path),
        products=lambda wildcards: list(FILES[wildcards.campaign].delivered()),
        pictures=lambda wildcards: FIGURES.files(FILES[wildcards.campaign]),
    output:
        report=f"{RESULTS}/report.pdf",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg.figures.survey_report.report:write_survey_report"),
        words=of(CampaignFiles.delivered),
        captions={row.name: row.caption for row in FIGURES.rows},
        settings=of(CampaignFiles.report_settings),
        title=TITLE,
        twin=TWIN,
    script:
        "../scripts/call.py"
