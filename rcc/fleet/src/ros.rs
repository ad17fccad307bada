//! ROS 2 by the format of rmw_zenoh: keys, tokens, messages, actions. No I/O.
