# A Stäubli TX90 with a tool of 100 mm.

[[robot]]
name = "tx90"
model = "staubli_tx90"
home = [0, 0, 90, 0, 60, 0]
tool = [0, 0, 100, 0, 0, 0]
joints = [
  { min = -180, max = 180, speed = 400, acceleration = 900, jerk = 9000 },
  { min = -130, max = 147.5, speed = 400, acceleration = 900, jerk = 9000 },
  { min = -145, max = 145, speed = 430, acceleration = 900, jerk = 9000 },
  { min = -270, max = 270, speed = 540, acceleration = 900, jerk = 9000 },
  { min = -115, max = 140, speed = 475, acceleration = 900, jerk = 9000 },
  { min = -270, max = 270, speed = 760, acceleration = 900, jerk = 9000 },
]
