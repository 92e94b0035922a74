"""What this package adds to handbench. Only the table is here: the code behind an entry is imported when it is used."""

from handbench.registry import Entry

LAMBERT = Entry(
    "example-lambert",
    "handbench_example.lambert:create",
    "mean texture, Lambertian, without shadows",
    presets=False,
)
MAE = Entry("example-mae", "handbench_example.mae:MAE", "mean absolute error of the pixels")
PROTOCOL = Entry("example", "handbench_example.protocol:PROTOCOL", "two painted balls, one of them never trained on")
BALL = Entry("example-ball", "handbench_example.ball:open_ball", "painted balls, drawn in closed form")
