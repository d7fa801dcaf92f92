"""The adaptive EKF: prediction, fusion, and how it follows noise, disturbances and parameters."""
