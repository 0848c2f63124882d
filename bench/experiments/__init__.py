"""Many runs: campaigns, the card, tuning, baselines and studies."""
