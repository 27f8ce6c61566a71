"""What a recording says about its own calibration: halves against each other, frames held out, chain against PnP."""
