"""Numbers for people: durations, counts, sizes. Pure functions."""


def format_duration(seconds: float | None) -> str:
    """Format a duration: `0.42 s`, `12.3 s`, `3 min 05 s`, `2 h 04 min`; `-` when unknown."""
    if seconds is None:
        return "-"
    if seconds < 9.995:
        return f"{seconds:.2f} s"
    if seconds < 99.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    if whole < 48 * 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole / 86400:.1f} days"


def format_count(number: float | None, unit: str = "") -> str:
    """Format a count with three digits: `999`, `12.3 k`, `4.56 M`, `1.20 G`; `-` when unknown."""
    if number is None:
        return "-"
    suffix = f" {unit}" if unit else ""
    size = abs(number)
    for factor, prefix in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        # 999.5 k rounds to 1000 k: the next prefix takes over half a digit early.
        if size >= factor * 0.9995:
            scaled = number / factor
            digits = 2 if abs(scaled) < 9.995 else 1 if abs(scaled) < 99.95 else 0
            return f"{scaled:.{digits}f} {prefix}{unit}"
    text = f"{number:.0f}" if float(number).is_integer() or size >= 100 else f"{number:.1f}"
    return text + suffix


def format_bytes(number: float) -> str:
    """Format a size in bytes with a decimal prefix: `17.3 MB`."""
    return format_count(number, "B")


def format_percent(fraction: float) -> str:
    """Format a fraction as a percentage: `12.3 %`; anything above 0 is not shown as 0."""
    if 0 < fraction < 0.0005:
        return "< 0.1 %"
    return f"{100 * fraction:.1f} %"
