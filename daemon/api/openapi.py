"""The description of the local interface for programs (OpenAPI 3.1), made of the models that check and answer.

``python -m daemon.api.openapi`` writes it to docs/openapi.json; a test compares.
"""

import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from daemon.api.configuration import QUERY_KEY
from daemon.api.models import (
    AuthorisedPage,
    CommandPage,
    DaysPage,
    ErrorPage,
    HealthPage,
    LinesPage,
    ScansPage,
    StatePage,
    SunPage,
)
from daemon.service.command_bodies import AcknowledgeBody, AutoBody, CommandBody, GotoBody, ModeBody, body_model
from daemon.service.operator_commands import COMMAND_NAMES, LONGEST_BODY
from daemon.store.history import KINDS_OF_LINES, KINDS_OF_NUMBERS

_REF = "#/components/schemas/{model}"
_CHECKED: tuple[type[BaseModel], ...] = (AcknowledgeBody, AutoBody, CommandBody, GotoBody, ModeBody)
_ANSWERS: tuple[type[BaseModel], ...] = (
    AuthorisedPage,
    CommandPage,
    DaysPage,
    ErrorPage,
    HealthPage,
    LinesPage,
    ScansPage,
    StatePage,
    SunPage,
)
_COMMAND_SUMMARIES = {
    "stop": "Stop the axes at once and keep them stopped until auto",
    "stow": "Go to the stow position and stay",
    "snow": "Go to the snow position and stay",
    "hold": "Stay here",
    "auto": "End all wishes of persons",
    "goto": "Go to a position inside the limits and hold there",
    "home": "Start a reference run of both axes",
    "clear": "Clear the faults and doubts that are shown",
    "relearn": "Forget what the law has learned of the site",
    "maintenance": "Stop the axes, keep them still and the alarms silent until auto",
    "mode": "One of the modes by its name",
    "acknowledge": "Note that a person has seen an alarm, or all; moves nothing and releases nothing",
}
_REFUSALS = {
    400: "the body is not understood",
    401: "the token is missing or wrong",
    409: "the tracker cannot do it now",
    413: f"the body has more than {LONGEST_BODY} bytes",
    421: "the host is not served, or the service is another configuration's",
    422: "outside the limits, no such tracker, or no such span of time",
    429: "more commands than the limits allow",
    503: "too many ask at once",
}
_SINCE = {
    "name": "since",
    "in": "query",
    "required": False,
    "description": "A time in UTC, ISO 8601; left out: from the oldest scan that is kept.",
    "schema": {"type": "string", "format": "date-time"},
}
_AT = {
    "name": "at",
    "in": "query",
    "required": False,
    "description": "An instant of the day, in UTC, ISO 8601, from 1970 to 2199; left out: now.",
    "schema": {"type": "string", "format": "date-time"},
}
_TRACKER = {
    "name": "tracker",
    "in": "query",
    "required": False,
    "description": "Which tracker is meant, where the body does not say.",
    "schema": {"type": "string"},
}
_CONFIGURATION = {
    "name": QUERY_KEY,
    "in": "query",
    "required": False,
    "description": "Path of the configuration whose service is meant, and other paths of the same file; a service with"
    " another configuration answers 421, even after a stop, which it carries out.",
    "schema": {"type": "array", "items": {"type": "string"}},
}


@cache
def description() -> dict[str, Any]:
    """Return the description."""
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "heliocube, the local interface",
            "version": version("heliocube"),
            "description": "docs/api.md says what stands behind each value, and which limits hold.",
        },
        "paths": {
            "/api/state": _state(),
            "/api/scans": _scans(),
            "/api/events": _text("The state once a second, and each record as it comes", "text/event-stream"),
            "/api/openapi.json": _text("This description", "application/json"),
            "/api/sun": _sun(),
            "/api/days": _page("The solar days of the site that have records", DaysPage, 409, 421, 503),
            "/api/history/{kind}": _history(),
            "/api/authorised": _authorised(),
            "/healthz": _health(),
            "/metrics": _text("Metrics for Prometheus", "text/plain"),
            **{f"/api/{name}": _command(name) for name in COMMAND_NAMES},
        },
        "components": {
            "schemas": _schemas(),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _schemas() -> dict[str, Any]:
    _, checked = models_json_schema([(model, "validation") for model in _CHECKED], ref_template=_REF)
    _, answers = models_json_schema([(model, "serialization") for model in _ANSWERS], ref_template=_REF)
    return dict(sorted((checked["$defs"] | answers["$defs"]).items()))


def _json_content(model: type[BaseModel]) -> dict[str, Any]:
    return {"application/json": {"schema": {"$ref": _REF.format(model=model.__name__)}}}


def _refusals(*statuses: int) -> dict[str, Any]:
    return {str(status): {"description": _REFUSALS[status], "content": _json_content(ErrorPage)} for status in statuses}


def _page(summary: str, model: type[BaseModel], *statuses: int) -> dict[str, Any]:
    answers = {"200": {"description": "the page", "content": _json_content(model)}} | _refusals(*statuses)
    return {"get": {"summary": summary, "responses": answers}}


def _text(summary: str, media_type: str) -> dict[str, Any]:
    answers = {"200": {"description": "the page", "content": {media_type: {}}}} | _refusals(421, 503)
    return {"get": {"summary": summary, "responses": answers}}


def _state() -> dict[str, Any]:
    found = _page("Everything there is to see", StatePage, 421, 503)
    found["get"]["parameters"] = [_CONFIGURATION]
    return found


def _scans() -> dict[str, Any]:
    found = _page("Scans that ended later", ScansPage, 400, 421, 503)
    found["get"]["parameters"] = [_SINCE]
    return found


def _sun() -> dict[str, Any]:
    found = _page("The sun's path over a solar day", SunPage, 400, 421, 422, 503)
    found["get"]["parameters"] = [_AT]
    return found


def _history() -> dict[str, Any]:
    found = _page("Stored records of a span of at most a week", LinesPage, 400, 409, 421, 422, 503)
    found["get"]["responses"]["200"]["content"]["application/octet-stream"] = {}
    kinds = {"type": "string", "enum": [*KINDS_OF_LINES, *KINDS_OF_NUMBERS]}
    found["get"]["parameters"] = [
        {"name": "kind", "in": "path", "required": True, "description": "Of records.", "schema": kinds},
        _SINCE | {"name": "from", "required": True, "description": "The begin, in UTC, ISO 8601; it is included."},
        _SINCE | {"name": "to", "required": True, "description": "The end, in UTC, ISO 8601; it is not included."},
        _TRACKER | {"description": "The tracker whose records are meant; may be left out if there is only one."},
    ]
    return found


def _authorised() -> dict[str, Any]:
    answers = {"200": {"description": "the token is right", "content": _json_content(AuthorisedPage)}} | _refusals(
        401, 421, 503
    )
    return {"post": {"summary": "Whether a token is the service's", "security": [{"token": []}], "responses": answers}}


def _health() -> dict[str, Any]:
    found = _page("Whether the work goes on", HealthPage, 421)
    either = [{"$ref": _REF.format(model=model.__name__)} for model in (HealthPage, ErrorPage)]
    found["get"]["parameters"] = [_CONFIGURATION]
    content = {"application/json": {"schema": {"anyOf": either}}}
    found["get"]["responses"]["503"] = {
        "description": "the work does not go on, or too many ask at once",
        "content": content,
    }
    return found


def _command(name: str) -> dict[str, Any]:
    body = {"content": _json_content(body_model(name)), "required": body_model(name) in (GotoBody, ModeBody)}
    answers = {"200": {"description": "carried out", "content": _json_content(CommandPage)}} | _refusals(*_REFUSALS)
    if name == "stop":
        # A stop is obeyed whatever its body is.
        del answers["400"], answers["413"], answers["429"]
    return {
        "post": {
            "summary": _COMMAND_SUMMARIES[name],
            "security": [{"token": []}],
            "parameters": [_TRACKER, _CONFIGURATION],
            "requestBody": body,
            "responses": answers,
        }
    }


def main() -> None:
    """Write docs/openapi.json."""
    path = Path(__file__).parents[2] / "docs" / "openapi.json"
    path.write_text(f"{json.dumps(description(), indent=1)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
