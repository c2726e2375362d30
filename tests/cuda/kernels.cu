// SPDX-License-Identifier: Apache-2.0
// The kernels whose machine code is counted (machine_code.sh): rules of Fast, features and alpha
// alone, 3 and 32 channels, 32 also as halves; networks of width 256 by one plane of bf16; points
// of avatars; of layers and losses of images one of each.
#include <rye/avatar/cuda/frame_words.hpp>
#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/device.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/loss/cuda/smoothness.hpp>
#include <rye/nn/cuda/mlp.hpp>
#include <rye/nn/cuda/upsampler.hpp>
#include <rye/splat/cuda/rasterizer.hpp>
#include <rye/splat/cuda/sh_color.hpp>
#include <rye/train/cuda/centring.hpp>
#include <rye/train/cuda/image_losses.hpp>
#include <rye/train/cuda/step_sums.hpp>

using namespace rye;
using Rules = FeaturesOnly<Fast>;
using Tiles = MlpTiles<1, 256, 128>;
using NarrowTiles = MlpTiles<1, 128, 64>;
using All = More<PaperEffects, Kappa>;
using Learned = More<All, GazeBy<LearnedQuaternion>>;
using Lit = More<All, HeadShading, EyesBy<DrivenFeatures>>;

template <class K>
const void* kernel() {
    return reinterpret_cast<const void*>(detail::run_kernel<K>);
}
const void* const kernels[] = {
    kernel<detail::ClearKernel>(),
    kernel<detail::ProjectKernel<Rules, NoDistortion>>(),
    kernel<detail::ProjectKernel<Rules, LensInMemory<NoDistortion>>>(),
    kernel<detail::ScanKernel>(),
    kernel<detail::BinKernel<Rules>>(),
    kernel<detail::BlendKernel<Rules, 3>>(),
    kernel<detail::BlendKernel<Rules, 32>>(),
    kernel<detail::BlendKernel<WithHalves<Rules>, 32>>(),
    kernel<detail::ReverseKernel<Rules, 3, false>>(),
    kernel<detail::ReverseKernel<Rules, 32, false>>(),
    kernel<detail::MergeKernel<Rules, NoDistortion, 3>>(),
    kernel<detail::MergeKernel<Rules, NoDistortion, 32>>(),
    kernel<detail::ShColorKernel<3>>(),
    kernel<detail::ShColorKernel<3, HarmonicsByBasis>>(),
    kernel<detail::ShColorVjpKernel<3>>(),
    kernel<detail::ShColorVjpKernel<3, HarmonicsByBasis>>(),
    kernel<detail::MlpForwardKernel<Tiles, LeakyRelu>>(),
    kernel<detail::MlpReverseKernel<Tiles, LeakyRelu>>(),
    kernel<detail::MlpForwardKernel<NarrowTiles, LeakyRelu>>(),
    kernel<detail::MlpReverseKernel<NarrowTiles, LeakyRelu>>(),
    kernel<detail::MlpWeightKernel<1, 256>>(),
    kernel<detail::MlpWeightKernel<1, 128>>(),
    kernel<detail::MlpMergeKernel<256>>(),
    kernel<detail::MlpFrameKernel>(),
    kernel<detail::MlpPackKernel>(),
    kernel<detail::MlpBiasKernel>(),
    kernel<detail::MlpColumnForwardKernel<LeakyRelu>>(),
    kernel<detail::MlpColumnReverseKernel<LeakyRelu>>(),
    kernel<detail::EachKernel<detail::MlpColumnWeight>>(),
    kernel<detail::ListCountKernel>(),
    kernel<detail::ListScanKernel>(),
    kernel<detail::ListPlaceKernel>(),
    kernel<detail::EachKernel<detail::InfluenceOfPoint<SquaredDistance>>>(),
    kernel<detail::EachKernel<detail::InfluencePull<SquaredDistance>>>(),
    kernel<detail::EachKernel<detail::EncodeNumber>>(),
    kernel<detail::EachKernel<detail::EncodeNumberVjp>>(),
    kernel<detail::EachKernel<detail::FieldAdd>>(),
    kernel<detail::FieldCotangentKernel>(),
    kernel<detail::FrameCodesKernel<All>>(),
    kernel<detail::FramePoseKernel<All>>(),
    kernel<detail::EachKernel<detail::FinishFacePoint<All>>>(),
    kernel<detail::EachKernel<detail::GazedFeature<4>>>(),
    kernel<detail::EachKernel<detail::GazedMean<All, 4>>>(),
    kernel<detail::SumsKernel<detail::FacePointVjp<All>>>(),
    kernel<detail::PlaceEyesKernel<All>>(),
    kernel<detail::EachKernel<detail::DriveBothEyes<All>>>(),
    kernel<detail::SumsKernel<detail::EyePointVjp<float, All, 0>>>(),
    kernel<detail::KappaVjpKernel<All>>(),
    kernel<detail::EachKernel<detail::EyeOffsetVjp<All>>>(),
    kernel<detail::MergeSumsKernel>(),
    kernel<detail::BeginStepKernel>(),
    kernel<detail::EachKernel<detail::StepPicturesAt>>(),
    kernel<detail::EachKernel<detail::ShownColours>>(),
    kernel<detail::EachKernel<detail::JoinGradients>>(),
    kernel<detail::RoomKernel>(),
    kernel<detail::EachKernel<detail::BoundNumbers>>(),
    kernel<detail::CentreRowsKernel>(),
    kernel<detail::CentreViewsKernel>(),
    kernel<detail::EndStepKernel>(),
    kernel<detail::EachKernel<detail::PutPicture>>(),
    kernel<detail::TakeTail>(),
    kernel<detail::PlaceEyesKernel<Learned>>(),
    kernel<detail::KappaVjpKernel<Learned>>(),
    kernel<detail::EachKernel<detail::TurnInputs>>(),
    kernel<detail::EachKernel<detail::NormalizeTurn>>(),
    kernel<detail::EachKernel<detail::NormalizeTurnVjp>>(),
    kernel<detail::EachKernel<detail::TurnInputsVjp>>(),
    kernel<detail::EachKernel<detail::TurnTriplet>>(),
    kernel<detail::EachKernel<detail::TurnTripletVjp>>(),
    kernel<detail::EachKernel<detail::EncodeGazeAngle>>(),
    kernel<detail::EachKernel<detail::DrivenPointInputs>>(),
    kernel<detail::SumsKernel<detail::DrivenTurnVjp>>(),
    kernel<detail::EachKernel<detail::DrivenFrameInputs>>(),
    kernel<detail::DrivenFrameVjpKernel>(),
    kernel<detail::FramePoseKernel<Lit>>(),
    kernel<detail::EachKernel<LightOfFrame>>(),
    kernel<detail::EachKernel<detail::ShadePoint>>(),
    kernel<detail::EachKernel<detail::ShadeGazedPoint>>(),
    kernel<detail::SumsKernel<detail::ShadeFaceVjp>>(),
    kernel<detail::SumsKernel<detail::ShadeEyesVjp>>(),
    kernel<detail::LightVjpKernel>(),
    kernel<detail::EachKernel<detail::PutWords>>(),
    kernel<detail::EachKernel<detail::GatherWords>>()};

using Byte = std::uint8_t;
using Below = detail::DoubledPixels<detail::ActivatedPixels>;
const void* const image_kernels[] = {
    kernel<detail::ConvolutionPackKernel>(),
    kernel<detail::ConvolutionKernel<detail::ConvolutionTiles<1, 32, 8, 4, 1>>>(),
    kernel<detail::ConvolutionKernel<detail::ConvolutionTiles<1, 64, 8, 2, 2>>>(),
    kernel<detail::ConvolutionKernel<detail::ConvolutionTiles<2, 64, 4, 4, 2>>>(),
    kernel<detail::ConvolutionKernel<detail::ConvolutionTiles<3, 32, 2, 4, 2>>>(),
    kernel<detail::ConvolutionWeightKernel<1, 32, 32>>(),
    kernel<detail::ConvolutionWeightKernel<1, 64, 64>>(),
    kernel<detail::ConvolutionWeightKernel<3, 32, 32>>(),
    kernel<detail::ConvolutionMergeKernel>(),
    kernel<detail::ImagePlanesKernel<1, Below>>(),
    kernel<detail::ImagePlanesKernel<1, detail::CotangentPixels>>(),
    kernel<detail::ImagePlanesKernel<1, detail::PooledPixels>>(),
    kernel<detail::ImagePlanesKernel<1, detail::LpipsPixels<Byte>>>(),
    kernel<detail::DoublingVjpKernel>(),
    kernel<detail::StripSumsKernel>(),
    kernel<detail::NormMergeKernel>(),
    kernel<detail::ChannelCotangentKernel>(),
    kernel<detail::OrderedSumKernel>(),
    kernel<detail::FirstChannelsKernel<detail::DoubledPixels<detail::PlainPixels>>>(),
    kernel<detail::AddChannelsKernel>(),
    kernel<detail::LastLayerKernel>(),
    kernel<detail::LastLayerVjpKernel>(),
    kernel<detail::PoolVjpKernel>(),
    kernel<detail::LpipsTruthKernel>(),
    kernel<detail::LpipsSliceKernel>(),
    kernel<detail::LpipsAddKernel>(),
    kernel<detail::DssimSlopesKernel<Byte>>(),
    kernel<detail::DssimPullKernel<Byte>>(),
    kernel<detail::HalveKernel<PictureDifference<Byte>>>(),
    kernel<detail::PyramidKernel<PictureDifference<Byte>>>(),
    kernel<detail::SmoothnessKernel>(),
    kernel<detail::RgbTermKernel<detail::PictureTarget<Byte>>>(),
    kernel<detail::ResizeKernel<Byte>>(),
    kernel<detail::ResizeVjpKernel>(),
    kernel<detail::LossReportKernel>()};
