# A KUKA LWR 4+. Its controller limits all axes alike.

[[robot]]
name = "lwr"
model = "kuka_lwr4"
home = [0, 30, 0, -70, 0, 80, 0]
joints = [
  { min = -170, max = 170, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -120, max = 120, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -170, max = 170, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -120, max = 120, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -170, max = 170, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -120, max = 120, speed = 110, acceleration = 220, jerk = 2200 },
  { min = -170, max = 170, speed = 110, acceleration = 220, jerk = 2200 },
]
