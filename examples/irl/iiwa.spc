# A KUKA LBR iiwa 14 R820, with two signals of its media flange: the cell file lists their names.

[[robot]]
name = "iiwa"
model = "kuka_iiwa14"
home = [0, 30, 0, -70, 0, 80, 0]
joints = [
  { min = -170, max = 170, speed = 85, acceleration = 250, jerk = 2500 },
  { min = -120, max = 120, speed = 85, acceleration = 250, jerk = 2500 },
  { min = -170, max = 170, speed = 100, acceleration = 250, jerk = 2500 },
  { min = -120, max = 120, speed = 75, acceleration = 250, jerk = 2500 },
  { min = -170, max = 170, speed = 130, acceleration = 250, jerk = 2500 },
  { min = -120, max = 120, speed = 135, acceleration = 250, jerk = 2500 },
  { min = -175, max = 175, speed = 135, acceleration = 250, jerk = 2500 },
]

[[signal]]
name = "part_present"
direction = "in"
kind = "digital"
channel = 0
io = "iiwa:0"

[[signal]]
name = "light"
direction = "out"
kind = "digital"
channel = 0
io = "iiwa:0"
