"""How long to wait for an answer and how often to ask, learnt from the answers."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

_SAMPLES = 15
_QUANTILE = 1.0 / 3.0
_TIMEOUT_IN_ROUND_TRIPS = 2.5
_MOST_DOUBLINGS = 2
_AMBIGUOUS_ANSWERS = 20
_AMBIGUOUS_ANSWERS_AT_FIRST = 4
_LONGER_THAN_QUICKEST = 1.25
_RATE_GAIN = 0.02
_FIRST_RATE = 0.25  # half lost each way: the worst link that is worth using
_RATE_CAUTION = 0.8
_FEWEST_TRIES = 4


@dataclass(frozen=True)
class RetryPolicy:
    """When to send again, and when to stop.

    Parameters
    ----------
    initial_timeout
        Seconds to wait while no round trip has been measured.
    min_timeout, max_timeout
        Bounds of the learnt timeout in seconds. Telemetry radios answer in 0.1 to 2 s.
    max_tries
        Times that a message is sent without an answer before the exchange fails.
    patience_s
        After so many seconds without an answer, a third of `max_tries` is enough to fail.
    """

    initial_timeout: float = 0.5
    min_timeout: float = 0.1
    max_timeout: float = 4.0
    max_tries: int = 48
    patience_s: float = 20.0

    def exhausted(self, tries: int, silent_s: float) -> bool:
        """Whether to stop after so many tries and so many seconds without an answer."""
        return tries >= self.max_tries or (
            silent_s >= self.patience_s and tries >= self.max_tries / 3
        )


class LinkEstimate:
    """Round-trip time and reliability of a link, for one kind of question.

    As in RFC 6298, the timeout follows from measured round trips of messages that were sent once
    (Karn's rule), and doubles when it proves too short. But it builds on a low quantile instead
    of mean and deviation: an autopilot that asks again by itself hides a lost message in a late
    answer, and those answers must not lengthen the timeout, which would let in later ones.

    A link slower than the first guess would never give a sample; when none of the last answers
    did although all took about as long, counted from the first time of asking, the timeout stays
    above that. (Losses, in contrast, spread these times widely.)

    A single loss does not lengthen the timeout: here it means noise, not congestion, as only one
    message is under way at a time, and autopilots forget a transfer after some seconds of
    silence. More in a row than the losses seen so far explain do.
    """

    def __init__(self, policy: RetryPolicy) -> None:
        self.policy = policy
        self._samples: deque[float] = deque(maxlen=_SAMPLES)
        self._timeouts = 0
        self._answer_rate = _FIRST_RATE
        self._ambiguous: deque[float] = deque(maxlen=_AMBIGUOUS_ANSWERS)

    @property
    def round_trip(self) -> float | None:
        """Typical round-trip time in seconds without losses, None before the first sample."""
        if not self._samples:
            return None
        return sorted(self._samples)[int(_QUANTILE * len(self._samples))]

    def answered(self, tries: int, seconds: float) -> None:
        """Take in an answer.

        Parameters
        ----------
        tries
            How often the question had been sent.
        seconds
            Time since it was sent first.
        """
        self._timeouts = 0
        self._answer_rate *= (1.0 - _RATE_GAIN) ** (tries - 1)
        self._answer_rate += _RATE_GAIN * (1.0 - self._answer_rate)
        if tries != 1:
            self._ambiguous.append(seconds)
            return
        self._ambiguous.clear()
        self._samples.append(seconds)

    def timed_out(self) -> None:
        """Take in that no answer came in time."""
        self._timeouts += 1

    @property
    def timeout(self) -> float:
        """Seconds to wait for an answer."""
        policy = self.policy
        round_trip = self.round_trip
        if round_trip is None:
            base = policy.initial_timeout
        else:
            base = _TIMEOUT_IN_ROUND_TRIPS * round_trip
        if self._looks_slow:
            base = max(base, _LONGER_THAN_QUICKEST * min(self._ambiguous))
        base = min(max(base, policy.min_timeout), policy.max_timeout)
        if self._timeouts:
            doublings = min(self._timeouts // self.suspicious_tries(0.05), _MOST_DOUBLINGS)
            base = min(base * 2.0**doublings, policy.max_timeout)
        return base

    @property
    def _looks_slow(self) -> bool:
        """Whether the ambiguous answers are those of a slow link rather than of a lossy one."""
        first = not self._samples
        if len(self._ambiguous) < (_AMBIGUOUS_ANSWERS_AT_FIRST if first else _AMBIGUOUS_ANSWERS):
            return False
        return max(self._ambiguous) < 2.0 * min(self._ambiguous)

    def suspicious_tries(self, chance: float = 1e-3) -> int:
        """How many unanswered tries are no longer explained by the link's losses.

        Parameters
        ----------
        chance
            Probability that so many tries in a row are lost on a link that is as it was.
        """
        lost = min(1.0 - _RATE_CAUTION * self._answer_rate, 0.9)
        return max(_FEWEST_TRIES, math.ceil(math.log(chance) / math.log(lost)))


class LinkEstimates:
    """Estimates for the two kinds of conversation.

    They differ because an autopilot that receives a list asks again by itself when something is
    lost, so that its answers come later than the round trip alone would make them.

    Parameters
    ----------
    policy
        Timeouts and retries.
    """

    def __init__(self, policy: RetryPolicy | None = None) -> None:
        policy = policy or RetryPolicy()
        self.sending = LinkEstimate(policy)
        self.asking = LinkEstimate(policy)
