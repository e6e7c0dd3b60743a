"""What the papers print: their numbers, what contradicts itself, and which suite reruns them."""
