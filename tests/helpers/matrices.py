"""A small matrix."""

from benchmarks.studies.sensor.plan import Matrix

FIRST, SEED = 2000, 2_100_000
SMALL = Matrix(
    vehicles=2,
    first_vehicle=FIRST,
    seed=SEED,
    repetitions=2,
    healthy=2,
    reference_drives=1,
    cycles=("us06",),
    ambients=("mild",),
    faults=(("delay_symmetric", (0.4,)),),
)
