import numpy as np
import pytest
import torch

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError, ShapeError, UnknownNameError
from neuralgrasps.model.field import GraspField
from neuralgrasps.model.mlp_field import PUBLISHED_SAMPLE, MlpConfig, MlpDecoder, MlpField
from neuralgrasps.model.mlp_kernels import activate, column_sums, gradient_sums, normalise_gradient

SMALL = {
    "batch": MlpConfig(layers=3, width=24, code_size=5),
    "weight and skip": MlpConfig(layers=4, width=24, code_size=5, norm="weight", skip_layers=(2,)),
    "none": MlpConfig(layers=2, width=16, code_size=5, norm="none", dropout=0.0),
}


def new_decoder(config: MlpConfig, seed: int = 0) -> MlpDecoder:
    decoder = MlpDecoder(config, generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        decoder.last.weight.mul_(10.0)
    return decoder


def some_inputs(config: MlpConfig, scenes: int = 3, points: int = 40, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(5)
    return (
        torch.randn(scenes, points, 3, generator=generator).to(dtype),
        torch.randn(scenes, config.code_size, generator=generator).to(dtype),
    )


def bits(tensor: torch.Tensor) -> np.ndarray:
    return tensor.view(torch.uint16).numpy()


@pytest.mark.parametrize("kind", SMALL)
def test_gradients_match_finite_differences(kind: str) -> None:
    decoder = new_decoder(SMALL[kind]).double()
    decoder.dropout = 0.0
    points, codes = some_inputs(SMALL[kind], points=12, dtype=torch.float64)
    weights = list(decoder.parameters())
    points.requires_grad_()
    codes.requires_grad_()
    for train in (True, False):
        decoder.train(train)
        out = decoder(points, codes)
        factors = torch.linspace(-1.0, 2.0, out.numel(), dtype=torch.float64).reshape(out.shape)
        for tensor in (points, codes, *weights):
            gradient = torch.autograd.grad((decoder(points, codes) * factors).sum(), tensor)[0]
            generator = torch.Generator().manual_seed(1)
            move = torch.randn(tensor.shape, generator=generator, dtype=torch.float64)
            values = []
            with torch.no_grad():
                for step in (1e-6, -2e-6):
                    tensor.add_(move, alpha=step)
                    values.append((decoder(points, codes) * factors).sum())
                tensor.add_(move, alpha=1e-6)
            numeric = float(values[0] - values[1]) / 2e-6
            assert float((gradient * move).sum()) == pytest.approx(numeric, rel=1e-4, abs=1e-6)


def test_a_layer_sees_point_and_code_joined() -> None:
    config = SMALL["weight and skip"]
    decoder = new_decoder(config).eval()
    points, codes = some_inputs(config)
    joined = torch.cat([points, codes[:, None].expand(-1, points.shape[1], -1)], dim=-1).flatten(0, 1)
    x = joined
    for i, linear in enumerate(decoder.hidden):
        x = torch.relu(linear(torch.cat([x, joined], dim=-1) if i == 2 else x))
    expected = torch.tanh(decoder.last(x)).reshape(3, -1, 2)
    assert torch.allclose(decoder(points, codes), expected, atol=1e-6)


def test_published_sizes() -> None:
    count = sum(p.numel() for p in MlpDecoder().parameters())
    assert count == pytest.approx(2.95e6, rel=0.01)
    sample = MlpDecoder(PUBLISHED_SAMPLE)
    assert sample.hidden[3].weight.shape == (512 - 259, 512) and sample.hidden[4].weight.shape == (512, 512)
    assert len(sample.hidden) == 9 and not len(sample.norms)


@pytest.mark.parametrize("train", [True, False])
def test_fused_layers_agree_with_plain_ones(train: bool) -> None:
    config = MlpConfig(layers=3, width=64, code_size=8)
    points, codes = some_inputs(config, scenes=4, points=500)
    outs, gradients = [], []
    for fast in (False, True):
        decoder = new_decoder(config).train(train)
        with torch.no_grad():
            for k, norm in enumerate(decoder.norms):  # figures of batch norm that matter
                norm.weight.uniform_(0.5, 1.5, generator=torch.Generator().manual_seed(k))
                norm.running_var.fill_(0.2)
                norm.running_mean.fill_(0.05)
        decoder.dropout, decoder.fast = 0.0, fast
        z = codes.clone().requires_grad_()
        out = decoder(points, z)
        (out - points.norm(dim=-1, keepdim=True)).square().sum().backward()
        outs.append(out.detach())
        last = [decoder.last.weight.grad]
        inner = [p.grad for n, p in decoder.named_parameters() if not n.startswith("last")] if train else []
        gradients.append([z.grad, *last, *inner])
        if train:
            outs += [norm.running_var for norm in decoder.norms]
    half = len(outs) // 2
    for a, b in zip(outs[:half], outs[half:], strict=True):
        assert torch.allclose(a, b, atol=0.03)
    for a, b in zip(*gradients, strict=True):
        assert float((a - b).norm() / a.norm()) < 0.1  # what bf16 autocast reaches too


def test_passes_of_fused_layers_by_numbers() -> None:
    generator = torch.Generator().manual_seed(0)
    y, g = (torch.randn(700, 16, generator=generator).bfloat16() for _ in range(2))
    total, squares = np.zeros(16), np.zeros(16)
    column_sums(bits(y), 0, 700, total, squares)
    assert np.allclose(total, y.double().sum(0), atol=1e-3) and np.allclose(
        squares, (y.double() ** 2).sum(0), rtol=1e-5
    )
    out = torch.empty_like(y)
    scale, shift = np.linspace(0.5, 2.0, 16).astype(np.float32), np.linspace(-1.0, 1.0, 16).astype(np.float32)
    activate(bits(y), 0, 700, scale, shift, np.uint32(0), np.uint32(3), bits(out))
    expected = torch.relu(y.float() * torch.from_numpy(scale) + torch.from_numpy(shift)).bfloat16()
    assert torch.equal(out, expected)
    masked = torch.where(out != 0, g, 0).double()
    mean = np.linspace(-0.3, 0.3, 16).astype(np.float32)
    total[:], squares[:] = 0.0, 0.0
    gradient_sums(bits(g), bits(out), bits(y), 0, 700, mean, total, squares)
    assert np.allclose(total, masked.sum(0), atol=1e-3)
    assert np.allclose(squares, (masked * (y.double() - torch.from_numpy(mean))).sum(0), atol=1e-3)
    changed = g.clone()
    normalise_gradient(bits(changed), bits(out), bits(y), 0, 700, scale, shift, mean)
    exact = masked * torch.from_numpy(scale) + y.double() * torch.from_numpy(shift) + torch.from_numpy(mean)
    assert torch.allclose(changed.double(), exact, rtol=2**-8, atol=1e-3)


def test_dropout_drops_the_share_and_keeps_the_mean() -> None:
    config = MlpConfig(layers=1, width=256, code_size=4, dropout=0.2)
    y = torch.ones(2000, 64).bfloat16()
    outs = []
    for seed in (1, 1, 2):
        out = torch.empty_like(y)
        scale = np.full(64, 1.25, np.float32)
        activate(bits(y), 0, 2000, scale, scale * 0, np.uint32(0.2 * 2**32), np.uint32(seed), bits(out))
        outs.append(out)
    assert float((outs[0] == 0).float().mean()) == pytest.approx(0.2, abs=0.005)
    assert float(outs[0].float().mean()) == pytest.approx(1.0, abs=0.01)
    assert torch.equal(outs[0], outs[1]) and not torch.equal(outs[0], outs[2])
    dropped = (outs[0] == 0).float()
    assert abs(float(((dropped[:, 1:] - 0.2) * (dropped[:, :-1] - 0.2)).mean())) < 0.003  # neighbours are independent
    assert abs(float(((dropped[1:] - 0.2) * (dropped[:-1] - 0.2)).mean())) < 0.003
    decoder = new_decoder(config).train()
    decoder.fast = True
    points, codes = some_inputs(config)
    a, b = decoder(points, codes), decoder(points, codes)
    decoder.dropout_step = 1
    assert torch.equal(a, b) and not torch.equal(a, decoder(points, codes))


def test_field_takes_and_gives_metres() -> None:
    config = SMALL["batch"]
    decoder = new_decoder(config)
    points, codes = some_inputs(config)
    small = MlpField(decoder, object_name="ball", normalisation=Normalisation(offset_O=np.zeros(3), scale_m=0.1))
    assert isinstance(small, GraspField)
    offset = np.array([0.2, -0.1, 0.3])
    large = MlpField(decoder, object_name="ball", normalisation=Normalisation(offset_O=offset, scale_m=0.25))
    a = small(points * 0.1, codes, hand="fetch", object_name="ball")
    b = large(points * 0.25 + torch.as_tensor(offset, dtype=torch.float32), codes, hand="fetch", object_name="ball")
    assert torch.allclose(a.sdf_hand * 2.5, b.sdf_hand, atol=1e-5)
    assert torch.allclose(a.sdf_object * 2.5, b.sdf_object, atol=1e-5)
    assert large.clamp_m == pytest.approx(0.05 * 0.25)
    distance = small.distance(codes[0].numpy(), "hand", batch=7)(points[0].numpy() * 0.1)
    assert np.allclose(distance, a.sdf_hand[0].detach().numpy(), atol=1e-6)


def test_field_never_drops_out() -> None:
    config = SMALL["batch"]
    decoder = new_decoder(config)
    field = MlpField(decoder, object_name="ball", normalisation=Normalisation(offset_O=np.zeros(3), scale_m=1.0))
    points, codes = some_inputs(config)
    before = field(points, codes, hand="fetch", object_name="ball").sdf_hand
    decoder.train()  # the published code left it on
    assert torch.equal(before, field(points, codes, hand="fetch", object_name="ball").sdf_hand)


def test_wrong_use_is_refused() -> None:
    field = MlpField(
        new_decoder(SMALL["batch"]), object_name="ball", normalisation=Normalisation(offset_O=np.zeros(3), scale_m=1.0)
    )
    with pytest.raises(UnknownNameError, match="'bal' is not known"):
        field(torch.zeros(1, 3), torch.zeros(1, 5), hand="fetch", object_name="bal")
    with pytest.raises(ShapeError, match=r"expected \(N, 5\)"):
        field(torch.zeros(1, 3), torch.zeros(1, 6), hand="fetch", object_name="ball")
    with pytest.raises(InputError, match="skip layer 3"):
        MlpConfig(layers=3, skip_layers=(3,))
    with pytest.raises(InputError, match="dropout is 1"):
        MlpConfig(dropout=1.0)
