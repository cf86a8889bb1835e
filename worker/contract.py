"""Names and constants that the API, the workers and the steward agree on.

Job: one place for every name that crosses a process border, so that a queue is spoken to by name and with ids only.
Invariant: nothing here imports anything; a change here is a change of the protocol between processes of one farm.
"""

# ---- RQ -----------------------------------------------------------------------------------------------------------

# Workers look into the queues in this order, so a higher band is served first; within a band, first come first served.
QUEUE_HIGH = "smalti-high"
QUEUE_NORMAL = "smalti-normal"
QUEUE_LOW = "smalti-low"
QUEUES: tuple[str, ...] = (QUEUE_HIGH, QUEUE_NORMAL, QUEUE_LOW)

TASK_PREPARE = "worker.tasks.prepare"
TASK_RENDER_RUN = "worker.tasks.render_run"
# A worker refuses every other name: whoever writes to Redis must not be able to name code to run.
TASKS = frozenset({TASK_PREPARE, TASK_RENDER_RUN})

# RQ's default of 180 s discards a finished tile, and SIGALRM does not stop a kernel: leases are the only time limit.
JOB_TIMEOUT_S = -1
# A hint's outcome is never read; 1 s (0 would skip RQ's own clean-up of the execution) keeps Redis from growing.
RESULT_TTL_S = 1
FAILURE_TTL_S = 1

# ---- leases -------------------------------------------------------------------------------------------------------

# A dead worker's tile starts again after at most 3.0 (lease) + 0.5 (janitor) + pick-up seconds: below the promised 5.
LEASE_TTL_MS = 3000
RENEW_EVERY_S = 1.0
JANITOR_EVERY_S = 0.5
RECONCILE_EVERY_S = 3.0
# A steward that is gone, or busy rebuilding, holds its Redis for its store this long: ten of its ticks.
STORE_TTL_S = 5
# A job without a sign of life for this long gets its hint again: longer than a hint waits in an idle farm.
STALLED_AFTER_S = 2.0

# An RQ job is a run of tiles: after this time the worker looks whether another job's hint is waiting. RQ costs about
# 2.2 ms a run, hence 0.2 % here.
RUN_S = 1.0
# Even alone, a run ends after this time and goes on through a hint like any other.
RUN_MAX_S = 60.0

# How often a tile may raise, and how often its worker may die with it, before the job fails. A lost lease is no proof
# of a bad tile (a stopped machine, a Redis outage), so it counts less than an exception.
MAX_TILE_ERRORS = 3
MAX_TILE_LOSSES = 5

# A SIGTERM drains for at most this long before the supervisor kills.
DRAIN_S = 5.0

# ---- Redis keys ---------------------------------------------------------------------------------------------------

KEY_EPOCH = "sm:e"  # string; set last after a rebuild: its presence says that the index is complete
KEY_JOB = "sm:j:"  # + job id: hash n, cols, next, done, state (r|c), rays, kernel_us
KEY_DONE = "sm:b:"  # + job id: bitmap of done tiles
KEY_RETRY = "sm:r:"  # + job id: set of tiles to hand out again
KEY_FAULTS = "sm:f:"  # + job id: hash "e<tile>" errors, "l<tile>" losses
KEY_LEASES = "sm:W"  # hash worker -> "<job>/<tile>"; tile "p" is the preparation
KEY_DEADLINES = "sm:L"  # sorted set worker -> deadline, ms of Redis' clock
KEY_PREPARING = "sm:P"  # hash job -> worker that prepares it
KEY_ACTIVE = "sm:active"  # set of job ids in the index
KEY_WORKERS = "sm:workers"  # hash worker -> JSON with its last sign of life
KEY_STORE = "sm:store"  # string with a time to live: identity of the store that all of this is about
KEY_CLAIM = "sm:a:"  # + job id: string with a time to live, the assembler that owns the job

# ---- wake-ups (pub/sub: a lost message costs a poll, never a job) --------------------------------------------------

CHANNEL_EVENTS = "sm:events"  # "<job> <seq> <state>" after each durable event
CHANNEL_CONTROL = "sm:control"  # "cancel <job>", to the workers' control threads
CHANNEL_ASSEMBLER = "sm:assemble"  # "<job>": a row of tiles is complete, or the job has just become active

# ---- files --------------------------------------------------------------------------------------------------------

RESULT_EXR = "result.exr"
RESULT_PNG = "result.png"
REPORT = "report.json"
PREVIEW_PNG = "preview.png"
RESULT_NAMES = frozenset({RESULT_EXR, RESULT_PNG, REPORT, PREVIEW_PNG})

MIN_TILE_PX = 16
MAX_TILE_PX = 512
BLOCK_PX = 16  # block of the absolute image grid; a tile's edge is a multiple of it
PREVIEW_MAX_PX = 512  # longest edge of preview.png

PROBLEM_PREFIX = "urn:smalti:problem:"


def queue_for(priority: int) -> str:
    """Return the queue of a priority of 0 to 100: thirds, the middle one being the default of 50."""
    if priority > 66:
        return QUEUE_HIGH
    return QUEUE_NORMAL if priority >= 34 else QUEUE_LOW
