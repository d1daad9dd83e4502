// Hand and eye by ViSP, for `hand_eye_cases.py --visp PROGRAM`.
//
// Standard input: the number of pairs, then base_T_hand and camera_T_board of each, 16 numbers by rows, metres.
// The last line of the output: the place of the camera on the hand, m, or nan where ViSP fails.
//
//     g++ -O2 visp_hand_eye.cpp -o visp_hand_eye $(pkg-config --cflags --libs visp)
#include <cstdio>
#include <iostream>
#include <limits>
#include <vector>
#include <visp3/vision/vpHandEyeCalibration.h>

static vpHomogeneousMatrix read_pose()
{
  vpHomogeneousMatrix pose;
  for (unsigned row = 0; row < 4; row++)
    for (unsigned column = 0; column < 4; column++) std::cin >> pose[row][column];
  return pose;
}

int main()
{
  int count = 0;
  std::cin >> count;
  std::vector<vpHomogeneousMatrix> robot, camera;
  for (int pair = 0; pair < count; pair++) {
    robot.push_back(read_pose());
    camera.push_back(read_pose());
  }
  vpHomogeneousMatrix found;
  bool failed = true;
  try {
    failed = vpHandEyeCalibration::calibrate(camera, robot, found) != 0;
  } catch (const vpException &) {
  }
  const double none = std::numeric_limits<double>::quiet_NaN();
  std::printf("\n");
  for (unsigned row = 0; row < 3; row++) std::printf("%.12g ", failed ? none : found[row][3]);
  std::printf("\n");
}
