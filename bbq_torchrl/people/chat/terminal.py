"""A chat in the terminal: input, output and outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.dialogue.judge import REASONS, Judge, card
from bbq_torchrl.utils.output import needed
from bbq_torchrl.utils.text import TextError, clean

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bbq_torchrl.domains import Goal
    from bbq_torchrl.people.dialogue.exchange import Answer, Memory
    from bbq_torchrl.people.dialogue.partner import Partner

COMMANDS = {
    "/acts": "what was understood, and what the agent thinks of its best actions",
    "/why": "why it took its action and not the next one",
    "/goal": "your goal card",
    "/help": "these commands",
    "/quit": "end the conversation",
}
_SHOWN = 6
_WITHOUT_ACTION = {
    "greeting": "it returned a greeting",
    "closing": "you ended the conversation",
    "multiple_choice": "it asked which name you meant",
    "not_sure": "it asked whether it understood you",
    "request": "you took a value back, and it asked again",
}


@dataclass(frozen=True)
class _Turn:
    """A text with its answer, and the memory before it."""

    memory: Memory | None
    answer: Answer
    seed: int


class Chat:
    """One conversation of a person with an agent.

    Args:
        partner: the agent.
        goal: the person's goal; ``None`` for free talk.
        screen: a rich console.
        names: the readable names of the slots.
        seed: the random seed.
        echo: whether to show the person's text, if no terminal does.
    """

    def __init__(
        self,
        partner: Partner,
        goal: Goal | None,
        screen: Any,
        *,
        names: Mapping[str, str],
        seed: int = 0,
        echo: bool = False,
    ) -> None:
        self._partner, self._goal, self._names, self._seed = partner, goal, names, seed
        self._screen, self._echo = screen, echo
        self._turns: list[_Turn] = []

    def run(self, read: Callable[[], str | None]) -> bool | None:
        """Talks until the person or the agent ends it, shows the outcome, then takes only commands.

        Args:
            read: returns the next line, or ``None`` at the end.

        Returns:
            Whether it was a success; ``None`` in free talk.
        """
        self._say("Talk to the agent in your own words. /help lists the commands.")
        self._show_goal()
        success, ended = None, ""
        for text in iter(read, None):
            name, *_ = text.split() or [""]
            if name == "/quit":
                break
            if self._echo and name:
                self._say(f"you: {_line(text)}")
            if name.startswith("/"):
                self._command(name)
            elif ended and name:
                self._say("The conversation is over: /acts, /why and /goal work, /quit leaves.")
            elif name and (ended := self._talk(text)):
                success = self._outcome(ended)
                self._say("/acts and /why show the last turn; /quit leaves.")
        return success if ended else self._outcome("")

    def _talk(self, text: str) -> str:
        memory = self._turns[-1].answer.memory if self._turns else None
        seed = (self._seed * 1_000_003 + len(self._turns)) % (1 << 31)
        answer = self._partner.reply(memory, text, seed)
        self._turns.append(_Turn(memory, answer, seed))
        self._say(f"agent: {answer.text}", style="bold")
        return answer.ended

    def _command(self, name: str) -> None:
        if name == "/help":
            for command, meaning in COMMANDS.items():
                self._say(f"{command}  {meaning}")
        elif name == "/goal":
            self._show_goal()
        elif name not in COMMANDS:
            self._say(f"A command must be one of {', '.join(COMMANDS)}, got {name[:50]!r}.")
        elif not self._turns:
            self._say("Nothing was said yet.")
        elif name == "/acts":
            self._show_acts(self._turns[-1])
        else:
            self._show_why(self._turns[-1])

    def _show_goal(self) -> None:
        if self._goal is None:
            self._say("There is no goal: ask for what you like.")
            return
        self._say("Your goal is a booking:")
        shown = card(self._goal, self._names)
        for name, value in shown["wishes"]:
            self._say(f"  {name}: {value}")
        for name in shown["questions"]:
            self._say(f"  find out: {name}")

    def _show_acts(self, turn: _Turn) -> None:
        answer, reading = turn.answer, turn.answer.reading
        if reading is None:
            self._say("understood: nothing")
            return
        self._say(
            f"understood: {reading.frame} (confidence {reading.confidence:.2f}, "
            f"by {'the endpoint' if reading.source == 'endpoint' else 'this package'})"
        )
        for unclear in reading.unclear:
            among = f", one of {', '.join(unclear.candidates)}" if unclear.candidates else ""
            self._say(f"unclear: {unclear.text} as {unclear.slot}{among}")
        if not answer.acted:
            why = _WITHOUT_ACTION.get(answer.answered.act, "it asked again")
            self._say(f"The agent took no action: {why}.")
            return
        if str(answer.understood) != str(reading.frame):
            self._say(f"with what was said before: {answer.understood}")
        self._say(f"the agent's act: {answer.answered}")
        if answer.control:
            self._say(f"its first choice was kept back by the rules {', '.join(answer.control)}")
        agent = self._partner.agent
        observation = self._partner.observe(turn.memory, answer.understood)
        beliefs = agent.beliefs(observation, turn.seed)
        if beliefs is None:
            values = agent.values(observation, turn.seed).items()
            self._table(("action", "Q"), [(name, f"{q:.2f}") for name, q in [*values][:_SHOWN]])
            self._say("This agent has no posterior: it does not know how sure it is.")
            return
        rows = [
            (item.action, f"{item.mean:.2f}", _band(item.band50), _band(item.band90),
             f"{item.p_best:.2f}")
            for item in beliefs.actions[:_SHOWN]
        ]  # fmt: skip
        self._table(("action", "mean Q", "50 %", "90 %", "P(best)"), rows)
        self._say(f"entropy of the best action: {beliefs.entropy:.2f} nats")

    def _show_why(self, turn: _Turn) -> None:
        answer = turn.answer
        reasons = None
        if answer.acted:
            observation = self._partner.observe(turn.memory, answer.understood)
            reasons = self._partner.agent.reasons(observation, turn.seed)
        if reasons is None:
            self._say("There are no two actions to compare here.")
            return
        self._say(f"{reasons.action} rather than {reasons.other}, in units of Q:")
        parts = [
            (part.group.replace("_", " "), f"{part.mean:+.2f}", _band(part.band90))
            for part in (*reasons.parts[:_SHOWN], reasons.difference)
        ]
        self._table(("because of", "mean", "90 %"), parts)

    def _outcome(self, ended: str) -> bool | None:
        how = {
            "agent": "The agent ended the conversation.",
            "person": "You ended the conversation.",
            "turns": "The conversation ended because it was too long.",
            "": "The conversation is over.",
        }
        self._say(how[ended])
        said = [(turn.answer.understood, turn.answer.answered) for turn in self._turns]
        if self._goal is None:
            complete = self._partner.domain.complete_slot
            offers = [act.informs for _, act in said if complete in act.informs]
            if not offers:
                self._say("No booking was offered.")
            else:
                kept = [f"{k}={v}" for k, v in offers[-1].items() if k != complete]
                self._say(f"The last offer: {offers[-1][complete]} ({', '.join(kept)}).")
            return None
        judge = Judge(self._partner.domain)
        reasons = judge.reasons(self._goal, said, in_time=ended != "turns")
        if not reasons:
            self._say("Success: you have got what your goal card says.")
        else:
            self._say(f"Failure: {'; '.join(REASONS[reason] for reason in reasons)}.")
        return not reasons

    def _say(self, text: str, style: str | None = None) -> None:
        # Lines are wrapped between words for people, and left whole for programs.
        self._screen.print(
            text,
            style=style,
            markup=False,
            highlight=False,
            emoji=False,
            soft_wrap=not self._screen.is_terminal,
        )

    def _table(self, names: Sequence[str], rows: Sequence[tuple[str, ...]]) -> None:
        table = needed("rich", "rich.table", "chat").Table()
        for number, name in enumerate(names):
            table.add_column(name, justify="right" if number else "left")
        for row in rows:
            table.add_row(*row)
        self._screen.print(table)


def _line(text: str) -> str:
    try:
        return clean(text)
    except TextError as error:
        return f"({error})"


def console() -> Any:
    """Returns a rich console on standard output."""
    return needed("rich", "rich.console", "chat").Console()


def prompt() -> Callable[[], str | None]:
    """Returns a reader of lines at a terminal, with history and completion of commands."""
    toolkit = needed("prompt_toolkit", "prompt_toolkit", "chat")
    session = toolkit.PromptSession(
        completer=toolkit.completion.WordCompleter(list(COMMANDS), sentence=True),
        # Tab completes as in a shell: a menu would keep empty lines below each prompt.
        complete_style=toolkit.shortcuts.CompleteStyle.READLINE_LIKE,
        complete_while_typing=False,
    )

    def read() -> str | None:
        try:
            line: str = session.prompt("you: ")
        except (EOFError, KeyboardInterrupt):
            return None
        return line

    return read


def _band(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.2f} to {ends[1]:.2f}"
