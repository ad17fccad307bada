# The arm of a KUKA youBot, counted from the upright arm. Its five axes reach poses whose z axis lies in a plane with axis 1.

[[robot]]
name = "youbot"
model = "kuka_youbot_upright"
home = [0, 0, 0, 0, 0]
speed = 60
acceleration = 200
jerk = 2000
joints = [
  { min = -169, max = 169, speed = 90, acceleration = 90, jerk = 900 },
  { min = -65, max = 90, speed = 90, acceleration = 90, jerk = 900 },
  { min = -151, max = 146, speed = 90, acceleration = 90, jerk = 900 },
  { min = -102.5, max = 102.5, speed = 90, acceleration = 90, jerk = 900 },
  { min = -167.5, max = 167.5, speed = 90, acceleration = 90, jerk = 900 },
]
