"""The parts of the pipeline that `blame` can replace by the truth, and what each replacement means."""

PARTS = {
    "odometry": "the wheels tell the true motion",
    "deskew": "the motion during a sweep is the true one; in the drive the lidar takes all beams at once",
    "front_end": "scan matching says the true pose of every scan",
    "loops": "every loop that was looked at is closed, with the true relative pose",
    "poses": "every scan is put where it truly was: only the grid is left to err",
    "localisation": "the robot that drives on the map knows where it is",
    "plan": "it plans on the true map",
}
