"""The parts of the pipeline that `ablate` can replace with ground truth, and what each replacement means."""

PARTS = {
    "odometry": "odometry is the true motion",
    "deskew": "the motion during a sweep is the true one; in the drive the lidar takes all beams at once",
    "front_end": "scan matching returns the true pose of every scan",
    "loops": "every loop candidate is closed with the true relative pose",
    "poses": "every scan is placed at its true pose: only the drawing of the grid can err",
    "localisation": "the robot that drives on the map knows its true pose",
    "plan": "it plans on the true map",
}
