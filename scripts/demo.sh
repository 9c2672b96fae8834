#!/usr/bin/env bash
# The whole loop at a size for two CPU cores: demonstrations of a few safes, dp3_adaptive trained on them, evaluated.
# Uses clouds only, so no renderer is needed. With one, it also draws the objects, and videos have colours.
# Sizes can be changed: SAFES=0:2 EPISODES=5 STEPS=200 EVALUATE=4 bash scripts/demo.sh
set -euo pipefail
cd "$(dirname "$0")/.."

out=${OUT:-outputs/demo}
safes=${SAFES:-0:4} episodes=${EPISODES:-40} steps=${STEPS:-2400} evaluate=${EVALUATE:-40}
bin=.venv/bin
export HF_HUB_OFFLINE=1 TOKENIZERS_PARALLELISM=false
say() { printf '\n== %s\n' "$*"; }

say "1/5  Pictures of the objects: $out/safes.png"
mkdir -p "$out"
if timeout 180 "$bin/python" -m lerobot_env_adamanip.sim.render_probe >/dev/null 2>&1; then
    "$bin/adamanip" objects --category safe --objects 0:36 --out "$out/safes.png"
else
    echo "none: no Vulkan device to render with (make pictures sets one up)"
fi

say "2/5  Adaptive demonstrations: pull, feel that it is locked, turn the knob, pull again"
"$bin/adamanip" collect "$out/demos" --category safe --expert adaptive --objects "$safes" --episodes-per-object "$episodes" \
    --repo-id local/adamanip-safe-demo --workers 2 --no-images
"$bin/adamanip" replay "$out/demos" --episode 0 --out "$out/demonstration.mp4"

say "3/5  Training dp3_adaptive with lerobot-train"
checkpoint=$out/train/checkpoints/last
if [ -f "$checkpoint/pretrained_model/train_config.json" ]; then
    echo "resuming $checkpoint"
    "$bin/lerobot-train" --config_path="$checkpoint/pretrained_model/train_config.json" --resume=true --steps="$steps"
else
    rm -rf "$out/train"
    "$bin/lerobot-train" --policy.type=dp3_adaptive --policy.device=cpu --policy.push_to_hub=false \
        --env.type=adamanip_safe --env.objects="$safes" --env_eval_freq=0 \
        --dataset.repo_id=local/adamanip-safe-demo --dataset.root="$out/demos" \
        --batch_size=64 --steps="$steps" --save_freq=800 --log_freq=100 --num_workers=0 --output_dir="$out/train"
fi

say "4/5  Evaluating on scenes it has not seen, with lerobot-eval"
rm -rf "$out/eval" "$out/eval.jsonl"
"$bin/lerobot-eval" --policy.path="$checkpoint/pretrained_model" --policy.device=cpu \
    --env.type=adamanip_safe --env.objects="$safes" --env.split=validation \
    --env.observe_images=false --env.episode_log="$out/eval.jsonl" \
    --eval.n_episodes="$evaluate" --eval.batch_size=2 --output_dir="$out/eval"

say "5/5  Results"
"$bin/adamanip" report "$out/eval.jsonl" --out "$out/success.png"
"$bin/adamanip" report "$out/eval.jsonl" --json > "$out/report.json"
cat <<END

  $out/safes.png            the objects
  $out/demonstration.mp4    a demonstration, replayed from its seed
  $out/eval/videos/         the policy at work
  $out/success.png          success over the episodes, with its interval
  $out/report.json          the numbers
END
