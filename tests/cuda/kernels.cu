// SPDX-License-Identifier: Apache-2.0
// The kernels whose machine code is counted (machine_code.sh): rules of Fast, features and alpha
// alone, 3 and 32 channels; networks of width 256 by one plane of bf16; points of avatars; of
// layers and losses of images one of each.
#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/device.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/loss/cuda/smoothness.hpp>
#include <rye/nn/cuda/mlp.hpp>
#include <rye/nn/cuda/upsampler.hpp>
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
const void* const kernels[] = {kernel<ProjectKernel<Rules, NoDistortion>>(),
                               kernel<ScanKernel>(),
                               kernel<BinKernel<Rules>>(),
                               kernel<BlendKernel<Rules, 3>>(),
                               kernel<BlendKernel<Rules, 32>>(),
                               kernel<ReverseKernel<Rules, 3, false>>(),
                               kernel<ReverseKernel<Rules, 32, false>>(),
                               kernel<MergeKernel<Rules, NoDistortion, 3>>(),
                               kernel<MergeKernel<Rules, NoDistortion, 32>>(),
                               kernel<ShColorKernel<3>>(),
                               kernel<ShColorKernel<3, HarmonicsByBasis>>(),
                               kernel<ShColorVjpKernel<3>>(),
                               kernel<ShColorVjpKernel<3, HarmonicsByBasis>>(),
                               kernel<MlpForwardKernel<Tiles, LeakyRelu>>(),
                               kernel<MlpReverseKernel<Tiles, LeakyRelu>>(),
                               kernel<MlpForwardKernel<NarrowTiles, LeakyRelu>>(),
                               kernel<MlpReverseKernel<NarrowTiles, LeakyRelu>>(),
                               kernel<MlpWeightKernel<1, 256>>(),
                               kernel<MlpWeightKernel<1, 128>>(),
                               kernel<MlpMergeKernel<256>>(),
                               kernel<MlpFrameKernel>(),
                               kernel<MlpPackKernel>(),
                               kernel<MlpBiasKernel>(),
                               kernel<MlpColumnForwardKernel<LeakyRelu>>(),
                               kernel<MlpColumnReverseKernel<LeakyRelu>>(),
                               kernel<EachKernel<MlpColumnWeight>>(),
                               kernel<ListCountKernel>(),
                               kernel<ListScanKernel>(),
                               kernel<ListPlaceKernel>(),
                               kernel<EachKernel<InfluenceOfPoint<SquaredDistance>>>(),
                               kernel<EachKernel<InfluencePull<SquaredDistance>>>(),
                               kernel<EachKernel<EncodeNumber>>(),
                               kernel<EachKernel<EncodeNumberVjp>>(),
                               kernel<EachKernel<FieldAdd>>(),
                               kernel<FieldCotangentKernel>(),
                               kernel<FrameCodesKernel<All>>(),
                               kernel<FramePoseKernel<All>>(),
                               kernel<EachKernel<FinishFacePoint<All>>>(),
                               kernel<EachKernel<GazedFeature<4>>>(),
                               kernel<EachKernel<GazedMean<All, 4>>>(),
                               kernel<SumsKernel<FacePointVjp<All>>>(),
                               kernel<PlaceEyesKernel<All>>(),
                               kernel<EachKernel<DriveBothEyes<All>>>(),
                               kernel<SumsKernel<EyePointVjp<float, All, 0>>>(),
                               kernel<KappaVjpKernel<All>>(),
                               kernel<EachKernel<EyeOffsetVjp<All>>>(),
                               kernel<MergeSumsKernel>(),
                               kernel<BeginStepKernel>(),
                               kernel<EachKernel<StepPicturesAt>>(),
                               kernel<EachKernel<ShownColours>>(),
                               kernel<EachKernel<JoinGradients>>(),
                               kernel<RoomKernel>(),
                               kernel<EachKernel<BoundNumbers>>(),
                               kernel<CentreRowsKernel>(),
                               kernel<CentreViewsKernel>(),
                               kernel<EndStepKernel>(),
                               kernel<EachKernel<PutPicture>>(),
                               kernel<TakeTail>(),
                               kernel<PlaceEyesKernel<Learned>>(),
                               kernel<KappaVjpKernel<Learned>>(),
                               kernel<EachKernel<TurnInputs>>(),
                               kernel<EachKernel<NormalizeTurn>>(),
                               kernel<EachKernel<NormalizeTurnVjp>>(),
                               kernel<EachKernel<TurnInputsVjp>>(),
                               kernel<EachKernel<TurnTriplet>>(),
                               kernel<EachKernel<TurnTripletVjp>>(),
                               kernel<EachKernel<EncodeGazeAngle>>(),
                               kernel<EachKernel<DrivenPointInputs>>(),
                               kernel<SumsKernel<DrivenTurnVjp>>(),
                               kernel<EachKernel<DrivenFrameInputs>>(),
                               kernel<DrivenFrameVjpKernel>(),
                               kernel<FramePoseKernel<Lit>>(),
                               kernel<EachKernel<LightOfFrame>>(),
                               kernel<EachKernel<ShadePoint>>(),
                               kernel<EachKernel<ShadeGazedPoint>>(),
                               kernel<SumsKernel<ShadeFaceVjp>>(),
                               kernel<SumsKernel<ShadeEyesVjp>>(),
                               kernel<LightVjpKernel>()};

using Byte = std::uint8_t;
using Below = DoubledPixels<ActivatedPixels>;
const void* const image_kernels[] = {kernel<ConvolutionPackKernel>(),
                                     kernel<ConvolutionKernel<ConvolutionTiles<1, 32, 8, 4, 1>>>(),
                                     kernel<ConvolutionKernel<ConvolutionTiles<1, 64, 8, 2, 2>>>(),
                                     kernel<ConvolutionKernel<ConvolutionTiles<2, 64, 4, 4, 2>>>(),
                                     kernel<ConvolutionKernel<ConvolutionTiles<3, 32, 2, 4, 2>>>(),
                                     kernel<ConvolutionWeightKernel<1, 32, 32>>(),
                                     kernel<ConvolutionWeightKernel<1, 64, 64>>(),
                                     kernel<ConvolutionWeightKernel<3, 32, 32>>(),
                                     kernel<ConvolutionMergeKernel>(),
                                     kernel<ImagePlanesKernel<1, Below>>(),
                                     kernel<ImagePlanesKernel<1, CotangentPixels>>(),
                                     kernel<ImagePlanesKernel<1, PooledPixels>>(),
                                     kernel<ImagePlanesKernel<1, LpipsPixels<Byte>>>(),
                                     kernel<DoublingVjpKernel>(),
                                     kernel<StripSumsKernel>(),
                                     kernel<NormMergeKernel>(),
                                     kernel<ChannelCotangentKernel>(),
                                     kernel<OrderedSumKernel>(),
                                     kernel<FirstChannelsKernel<DoubledPixels<PlainPixels>>>(),
                                     kernel<AddChannelsKernel>(),
                                     kernel<LastLayerKernel>(),
                                     kernel<LastLayerVjpKernel>(),
                                     kernel<PoolVjpKernel>(),
                                     kernel<LpipsTruthKernel>(),
                                     kernel<LpipsSliceKernel>(),
                                     kernel<LpipsAddKernel>(),
                                     kernel<DssimSlopesKernel<Byte>>(),
                                     kernel<DssimPullKernel<Byte>>(),
                                     kernel<HalveKernel<PictureDifference<Byte>>>(),
                                     kernel<PyramidKernel<PictureDifference<Byte>>>(),
                                     kernel<SmoothnessKernel>(),
                                     kernel<RgbTermKernel<PictureTarget<Byte>>>(),
                                     kernel<ResizeKernel<Byte>>(),
                                     kernel<ResizeVjpKernel>(),
                                     kernel<LossReportKernel>()};
