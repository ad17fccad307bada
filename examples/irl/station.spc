# Three servo axes of EtherCAT terminals: analogue outputs, encoders, and digital inputs and outputs. They move their joints only.
# The cell file has the axes and `io`.

[[robot]]
name = "station"
joints = [
  { min = -90, max = 90, speed = 80, acceleration = 250, jerk = 2500 },
  { min = -90, max = 90, speed = 80, acceleration = 250, jerk = 2500 },
  { min = -90, max = 90, speed = 80, acceleration = 250, jerk = 2500 },
]

[[signal]]
name = "start"
direction = "in"
kind = "digital"
channel = 0
io = "io:0"

[[signal]]
name = "order"
direction = "in"
kind = "binary"
channel = 0
bits = 3
io = "io:1"

[[signal]]
name = "done"
direction = "out"
kind = "binary"
channel = 0
bits = 4
io = "io:0"
