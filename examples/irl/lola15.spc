# System specification of the LOLA 15 test station. The dimensions of this arm are not public: it moves its joints only.

[[robot]]
name = "lola_15"
joints = [
  { min = -160, max = 160, speed = 90, acceleration = 360, jerk = 3600 },
  { min = -100, max = 100, speed = 90, acceleration = 360, jerk = 3600 },
  { min = -130, max = 130, speed = 90, acceleration = 360, jerk = 3600 },
  { min = -180, max = 180, speed = 150, acceleration = 600, jerk = 6000 },
  { min = -110, max = 110, speed = 150, acceleration = 600, jerk = 6000 },
  { min = -270, max = 270, speed = 200, acceleration = 800, jerk = 8000 },
]
