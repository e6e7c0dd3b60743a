"""Plain numbers as callers write them: whole ones are numbers too."""

Number = float | int
Triple = tuple[Number, Number, Number]
Pair = tuple[Number, Number]
