"""What the filter knows of the arm: its dynamics, their derivatives and learned parameters."""
