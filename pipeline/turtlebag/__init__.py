"""TurtleBag: reproducible graph-SLAM and navigation for TurtleBot3 bags, without ROS."""
