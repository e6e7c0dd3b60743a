"""Pipelines of diffusers with tiny networks of random weights, in folders as the library writes them."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

CROSS = 16
"""Channels of a word."""


def of_the_extra(name: str) -> Any:
    """A library of the extra, or a skipped test."""
    return pytest.importorskip(name, reason="the extra 'priors' is not installed")


def parts(folder: Path, latents: int) -> dict[str, Any]:
    """What both pipelines are made of.

    Args:
        folder: Where the words are written down.
        latents: Input channels of the network.
    """
    diffusers, transformers = of_the_extra("diffusers"), of_the_extra("transformers")
    torch.manual_seed(0)
    words = {"<|startoftext|>": 0, "<|endoftext|>": 1, "a</w>": 2, "e</w>": 3, "o</w>": 4}
    words |= {letter: 5 + i for i, letter in enumerate("abcdefghijklmnopqrstuvwxyz")}
    (folder / "vocab.json").write_text(json.dumps(words))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    text = transformers.CLIPTextConfig(
        hidden_size=CROSS, intermediate_size=16, num_hidden_layers=1, num_attention_heads=2,
        vocab_size=len(words), max_position_embeddings=77, bos_token_id=0, eos_token_id=1, pad_token_id=1,
    )  # fmt: skip
    return {
        "vae": diffusers.AutoencoderKL(
            block_out_channels=[8, 8, 8, 8], norm_num_groups=4, latent_channels=4,
            down_block_types=["DownEncoderBlock2D"] * 4, up_block_types=["UpDecoderBlock2D"] * 4,
        ),
        "unet": diffusers.UNet2DConditionModel(
            in_channels=latents, out_channels=4, sample_size=64, block_out_channels=[8, 16], layers_per_block=1,
            norm_num_groups=4, cross_attention_dim=CROSS, attention_head_dim=4,
            down_block_types=["CrossAttnDownBlock2D", "DownBlock2D"],
            up_block_types=["UpBlock2D", "CrossAttnUpBlock2D"],
        ),
        "text_encoder": transformers.CLIPTextModel(text),
        "tokenizer": transformers.CLIPTokenizer(
            str(folder / "vocab.json"), str(folder / "merges.txt"), model_max_length=77
        ),
    }  # fmt: skip


def sd_turbo(folder: Path) -> Path:
    """A StableDiffusionImg2ImgPipeline with the scheduler of SD-Turbo."""
    diffusers = of_the_extra("diffusers")
    made = diffusers.StableDiffusionImg2ImgPipeline(
        **parts(folder, 4), safety_checker=None, feature_extractor=None, requires_safety_checker=False,
        scheduler=diffusers.EulerDiscreteScheduler(
            beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", timestep_spacing="trailing",
            steps_offset=1,
        ),
    )  # fmt: skip
    made.save_pretrained(folder / "sd-turbo")
    return folder / "sd-turbo"


def marigold(folder: Path, prediction: str) -> Path:
    """A MarigoldDepthPipeline.

    Args:
        folder: Where it is saved.
        prediction: depth or disparity.
    """
    diffusers = of_the_extra("diffusers")
    made = diffusers.MarigoldDepthPipeline(
        **parts(folder, 8), prediction_type=prediction, default_denoising_steps=1,
        default_processing_resolution=0,
        scheduler=diffusers.DDIMScheduler(
            beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear", timestep_spacing="trailing",
            prediction_type="v_prediction", clip_sample=False, rescale_betas_zero_snr=True,
        ),
    )  # fmt: skip
    made.save_pretrained(folder / "marigold")
    return folder / "marigold"
