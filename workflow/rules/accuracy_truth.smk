"""Results of the digital twin against its truth: a rule for each entry of the table below. No other rules but these,
those of bed and change, and the twin's own may read the truth.
"""

TRUTH = {
    "compare_with_truth": {
        "shows": "Error of each point of a twin campaign against the true surface.",
        "calls": "thalweg_lab.truth.points:judge_cloud",
        "inputs": {
            "points": f"{RESULTS}/lidar/points.laz",
            "trajectory": f"{RESULTS}/orientation/trajectory.parquet",
            "mounts": f"{RESULTS}/calibration/mounts.json",
            "scene": f"{RESULTS}/simulation/truth/scene.npz",
            "voyage": f"{RESULTS}/simulation/truth/trajectory.parquet",
            "true_mounts": f"{RESULTS}/simulation/truth/mounts.json",
            "shots": f"{RESULTS}/simulation/truth/lidar_shots.parquet",
        },
        "outputs": {
            "statistics": f"{RESULTS}/accuracy/truth_statistics.csv",
            "by_range": f"{RESULTS}/accuracy/truth_by_range.csv",
            "scores": f"{RESULTS}/accuracy/filter_scores.csv",
        },
        "params": {
            "twin": of(CampaignFiles.twin_parts, "lidar", "ins", "gnss"),
            "vertical_corrections": section("lidar", "vertical_corrections"),
            "position_source": of(CampaignFiles.position_source),
        },
        "memory_mb": 4000,
    },
    "compare_calibration_with_truth": {
        "shows": "Calibration of a twin's boat against where its sensors truly sit.",
        "calls": "thalweg_lab.truth.calibration:judge_boat",
        "inputs": {
            "boat": f"{RESULTS}/calibration/boat.yaml",
            "camera_lidar": f"{RESULTS}/calibration/camera_lidar.yaml",
            "camera": f"{RESULTS}/calibration/camera.yaml",
            "clock": f"{RESULTS}/timing/camera_clock.yaml",
            "true_mounts": f"{RESULTS}/simulation/truth/mounts.json",
        },
        "outputs": {"table": f"{RESULTS}/accuracy/calibration_truth.csv"},
        "params": {"twin": of(CampaignFiles.twin_parts, "camera")},
    },
    "compare_rig_with_truth": {
        "shows": "Calibration of a twin's rig, and its middle panorama, against the truth.",
        "calls": "thalweg_lab.truth.rig:judge_rig",
        "inputs": {
            "calibration": of(CampaignFiles.rig_calibration),
            "poses": of(CampaignFiles.rig_poses),
            "panoramas": f"{RESULTS}/panorama/panoramas.parquet",
            "pictures": f"{RESULTS}/panorama/pictures",
            "truth": f"{RESULTS}/simulation/truth/rig.json",
            "true_poses": f"{RESULTS}/simulation/truth/rig_poses.parquet",
            "true_panorama": f"{RESULTS}/simulation/truth/panorama.npz",
            "coloured": of(CampaignFiles.coloured),
        },
        "outputs": {"out": f"{RESULTS}/accuracy/truth_rig.csv"},
        "params": {"rig": of(CampaignFiles.rig_views)},
    },
    "compare_chains_with_truth": {
        "shows": "Poses by INS, camera and all sensors of a twin campaign against the true ones.",
        "calls": "thalweg_lab.truth.solutions:judge_chains",
        "inputs": {
            "trajectories": of(CampaignFiles.trajectories),
            "mounts": f"{RESULTS}/calibration/mounts.json",
            "boat": of(CampaignFiles.camera_calibration),
            "rig": of(CampaignFiles.rig_truth),
            "voyage": f"{RESULTS}/simulation/truth/trajectory.parquet",
            "true_mounts": f"{RESULTS}/simulation/truth/mounts.json",
        },
        "outputs": {"table": f"{RESULTS}/accuracy/chains_truth.csv"},
        "params": {
            "twin": of(CampaignFiles.twin_parts, "ins", "gnss"),
            "position_source": of(CampaignFiles.position_source),
        },
    },
    "compare_light_sheet_with_truth": {
        "shows": "Calibration of the twin's light-sheet sensor against the sensor that took the images.",
        "calls": "thalweg_lab.truth.calibration:judge_light_sheet",
        "inputs": {
            "sensor": f"{RESULTS}/triangulation/sensor.yaml",
            "truth": f"{RESULTS}/simulation/truth/light_sheet/calibration",
        },
        "outputs": {"table": f"{RESULTS}/accuracy/light_sheet_truth.csv"},
        "params": {},
    },
    "compare_bed_with_truth": {
        "shows": "Errors of the bed points of the twin's boat against the true bed.",
        "calls": "thalweg_lab.truth.points:judge_bed_strip",
        "inputs": {
            "points": f"{RESULTS}/triangulation/strip/points.parquet",
            "truth": f"{RESULTS}/simulation/truth/light_sheet/strip",
        },
        "outputs": {
            "statistics": f"{RESULTS}/accuracy/truth_bed_strip.csv",
            "lines": f"{RESULTS}/accuracy/truth_bed_strip_lines.csv",
        },
        "params": {},
    },
    "compare_dtm_with_truth": {
        "shows": "Errors of the twin's terrain model by source, and of its steps where sources meet.",
        "calls": "thalweg_lab.truth.riverbed:judge_dtm",
        "inputs": {
            "dtm": f"{RESULTS}/fusion/dtm.tif",
            "scene": f"{RESULTS}/simulation/truth/scene.npz",
        },
        "outputs": {"table": f"{RESULTS}/accuracy/truth_dtm.csv"},
        "params": {"campaign": identity("origin")},
        "memory_mb": 3000,
    },
}

for name, entry in TRUTH.items():

    rule:
        name:
            name
        input:
            **entry["inputs"],
        output:
            **entry["outputs"],
        resources:
            mem_mb=memory(entry.get("memory_mb", 2000)),
            runtime=minutes(10),
        params:
            **entry["params"],
            **calls(entry["calls"]),
        script:
            "../scripts/call.py"
