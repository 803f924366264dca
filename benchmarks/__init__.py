"""What is measured beside the commands: the paper, scaling, estimates of errors, costs of effects. Run from the checkout."""
