"""The ROS 2 nodes: thin shells around the library, the only place that imports rclpy."""
