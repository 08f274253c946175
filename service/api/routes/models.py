"""The route of models."""

from __future__ import annotations

from fastapi import APIRouter, Depends

from .. import schemas
from ..auth import caller
from ..openapi import CALLER, errors
from ..schemas import Model
from ..state import StateIn

router = APIRouter(tags=["models"])


@router.get("/models", dependencies=[Depends(caller)], responses=errors(*CALLER))
async def models(state: StateIn) -> list[Model]:
    """Return the models that jobs may name."""
    default = state.settings.default_model
    return [model.model_copy(update={"default": name == default}) for name, model in schemas.shipped().items()]
