"""What else the data want: effects that the model leaves out, each as extra columns to the frames' moments."""
