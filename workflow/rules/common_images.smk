"""What the rules of the images and of the trajectories beside the INS share."""


def images(*keys):
    """Input function for params: a value or a part of the section `images`."""

    def value(wildcards):
        found = CAMPAIGNS[wildcards.campaign].plain()["images"]
        for key in keys:
            found = found[key]
        return found

    return value


def has_time_lapse(name):
    """True if a survey has images of the bank."""
    return bool(logs_of(name, "time_lapse")) and not CAMPAIGNS[name].is_calibration


def stamped_images(wildcards):
    """Input function: the images of the boat's camera in motion, on the river or about the cones."""
    name = wildcards.campaign
    return logs_of(name, "time_lapse") or logs_of(name, "run_images")


def names_hold_folders(wildcards):
    """Params function: true for a survey, whose cameras may have folders of their own."""
    return has_time_lapse(wildcards.campaign)


def stamp_tables(wildcards):
    """Input function: tables of the times of those images."""
    name = wildcards.campaign
    return logs_of(name, "time_lapse_times") or logs_of(name, "image_times")


def stamp_options(key):
    """Params function: how the times of those images are written."""

    def value(wildcards):
        plain = CAMPAIGNS[wildcards.campaign].plain()
        river = has_time_lapse(wildcards.campaign)
        return (
            plain["images"]["times"] if river else plain["calibration"]["image_times"]
        )[key]

    return value


def known_interior(wildcards):
    """Input function: the same for the size of the survey's images."""
    found = calibrated_interior(wildcards)
    return (
        [f"results/{wildcards.campaign}/orientation/camera_start.yaml"] if found else []
    )


def folder_interiors(wildcards):
    """Input function: interior orientations of the cameras of single folders, in the order of these."""
    name = wildcards.campaign
    return [
        file
        for folder in interior_folders(wildcards)
        for file in logs_of(name, f"interior.{folder}")
    ]


def interior_folders(wildcards):
    """Params function: folders whose camera has an interior orientation of its own."""
    logs = CAMPAIGNS[wildcards.campaign].logs
    return list(logs.time_lapse.interiors) if logs else []


def pair_parts(wildcards):
    """Input function: the compared pairs of images of all parts."""
    parts = CAMPAIGNS[wildcards.campaign].images.mapping.parts
    folder = f"results/{wildcards.campaign}/orientation/sfm"
    return [f"{folder}/pairs_{part}.npz" for part in range(parts)]


def feature_parts(wildcards):
    """Input function: the features of all parts of the images."""
    parts = CAMPAIGNS[wildcards.campaign].images.features.parts
    folder = f"results/{wildcards.campaign}/orientation/sfm"
    return [f"{folder}/features_{part}.npz" for part in range(parts)]


def has_finished_orientations(name):
    """True if another program has oriented the images of a survey."""
    return bool(logs_of(name, "finished_orientations"))


def images_hold_positions(wildcards):
    """Params function: whether the antenna's positions were observations of the image block."""
    name = wildcards.campaign
    antenna = CAMPAIGNS[name].plain()["images"]["adjustment"]["antenna"]
    return antenna["use"] and not has_finished_orientations(name)


def oriented_images(wildcards):
    """Input function: poses of the images, adjusted here or by another program."""
    finished = has_finished_orientations(wildcards.campaign)
    name = "image_poses_finished" if finished else "image_poses"
    return f"results/{wildcards.campaign}/orientation/{name}.parquet"


def best_chain(name):
    """What the best trajectory of a campaign rests on: all sensors where there are images of the bank, else the INS.

    The camera alone is no third case: where it has a trajectory, all sensors together have one.
    """
    return "fused" if has_time_lapse(name) else "ins"


def best_trajectory(wildcards):
    """Input function: the trajectory for everything that is placed by one and is no comparison of several."""
    ending = {"fused": "_fused", "ins": ""}[best_chain(wildcards.campaign)]
    return f"results/{wildcards.campaign}/orientation/trajectory{ending}.parquet"


def trajectory_of_chain(wildcards):
    """Input function: the boat's trajectory by camera or by all sensors together."""
    return (
        f"results/{wildcards.campaign}/orientation/trajectory_{wildcards.chain}.parquet"
    )


def mounts_of_chain(wildcards):
    """Input function: places of the sensors; by the camera the lidar sits where their relative orientation says."""
    camera = wildcards.chain == "camera"
    return (
        f"results/{wildcards.campaign}/orientation/mounts_camera.json"
        if camera
        else f"results/{wildcards.campaign}/calibration/mounts.json"
    )


def chain_trajectories(wildcards):
    """Input function: trajectories by INS, camera and all sensors, in this order."""
    folder = f"results/{wildcards.campaign}/orientation"
    return [
        f"{folder}/trajectory{ending}.parquet" for ending in ("", "_camera", "_fused")
    ]


def of_chains(folder, name):
    """Input function: a result of the clouds by INS, camera and all sensors, in this order."""
    return lambda wildcards: [
        f"results/{wildcards.campaign}/{folder}/{part}{name}"
        for part in ("", "by_camera/", "by_fused/")
    ]


def of_compared_chains(name):
    """Input function: the same of their comparison with a reference; nothing where there is none."""
    return lambda wildcards: (
        of_chains("accuracy", name)(wildcards)
        if has_reference(wildcards.campaign)
        else []
    )


def chains_truth(wildcards):
    """Input function: errors of the trajectories of a twin against its truth."""
    twin = is_twin(wildcards.campaign)
    return [f"results/{wildcards.campaign}/accuracy/chains_truth.csv"] if twin else []


def chain_steps(chain):
    """Input function: a result of each job that belongs to one chain alone, for its computing time."""

    def steps(wildcards):
        folder = f"results/{wildcards.campaign}/orientation"
        own = [
            "masks",
            "sfm/matches.npz",
            "sfm/block.npz",
            "control_marks.csv",
            "image_poses.parquet",
        ]
        finished = has_finished_orientations(wildcards.campaign)
        names = {
            "ins": ["trajectory.parquet"],
            "camera": [
                *(["image_poses_finished.parquet"] if finished else own),
                "image_poses_timed.parquet",
                "trajectory_camera.parquet",
            ],
            "fused": ["trajectory_fused.parquet"],
        }[chain]
        own_camera = chain == "camera" and not finished
        scattered = (
            [*feature_parts(wildcards), *pair_parts(wildcards)] if own_camera else []
        )
        return [*scattered, *(f"{folder}/{name}" for name in names)]

    return steps


OWN_IMAGE_PICTURES = ["mask_view", "image_positions"]
CHAIN_PICTURES = ["chain_histograms", "chains_by_range"]
"""Pictures of an adjustment of our own, and of a comparison of trajectories with a reference."""


def image_pictures(name):
    """Pictures of the image branch of a campaign, by name."""
    compared = CHAIN_PICTURES if has_reference(name) else []
    own = [] if has_finished_orientations(name) else OWN_IMAGE_PICTURES
    return [*compared, "pose_sigmas", *own, "frames_by_image"]


def chain_pictures(wildcards):
    """Input function: the pictures of the page on the trajectories."""
    name = wildcards.campaign
    return [f"results/{name}/figures/{picture}.png" for picture in image_pictures(name)]


def control_reports(wildcards):
    """Input function: the adjustment's report on control and check points, where there are control points."""
    name = wildcards.campaign
    given = logs_of(name, "control_points") and not has_finished_orientations(name)
    return [f"results/{name}/orientation/control_points.csv"] if given else []
